// Convex polytopes as arrays, and as coal's shapes.
#pragma once

#include <Eigen/Core>
#include <memory>

namespace coal {
class CollisionGeometry;
}

namespace contactvi {

// Vertices and triangles of a convex polytope.
struct Polytope {
  Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor> vertices;  // [m]
  Eigen::Matrix<int, Eigen::Dynamic, 3, Eigen::RowMajor> faces;  // indices of vertices, anticlockwise from outside
};

// Coal's shape of a polytope, equal to the one that coal's own constructor makes. Throws Error for indices of no vertex
// and for a vertex with more neighbours than coal can count.
std::shared_ptr<coal::CollisionGeometry> shape_of(const Polytope& polytope);

}  // namespace contactvi

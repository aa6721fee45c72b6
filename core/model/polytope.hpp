// Convex polytopes as arrays.
#pragma once

#include <Eigen/Core>

namespace contactvi {

// Vertices and triangles of a convex polytope.
struct Polytope {
  Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor> vertices;  // [m]
  Eigen::Matrix<int, Eigen::Dynamic, 3, Eigen::RowMajor> faces;  // indices of vertices, anticlockwise from outside
};

}  // namespace contactvi

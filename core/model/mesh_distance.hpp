// Signed distances from a closed mesh.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "model/box_tree.hpp"

namespace contactvi {

// Triangles anticlockwise seen from outside. The sign is that of the side of the nearest feature: of a triangle's
// normal, of the sum of the normals at an edge, of those at a vertex weighted by their angles (Baerentzen, Aanaes,
// "Signed distance computation using the angle weighted pseudonormal", IEEE TVCG 11, 2005).
class MeshDistance {
 public:
  using Points = Eigen::Ref<const Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>>;
  using Faces = Eigen::Ref<const Eigen::Matrix<int, Eigen::Dynamic, 3, Eigen::RowMajor>>;

  MeshDistance(const Points& vertices, const Faces& faces);

  // Of a point, negative inside. limit: no less than its distance [m].
  double of(const Vec3& x, double limit) const;

 private:
  struct Triangle {
    Vec3 corner[3];
    Vec3 normals[7];  // of the corners, of the edges from corner k to the next, and its own
  };

  static std::vector<BoxTree::Box> boxes(const Points& vertices, const Faces& faces);

  std::vector<Triangle> triangles_;
  BoxTree tree_;
};

}  // namespace contactvi

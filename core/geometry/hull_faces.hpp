// The flat faces of a convex hull that is given by its triangles. Coplanar triangles are one face, also where they
// are so only in single precision.
#pragma once

#include <coal/data_types.h>

#include <cstddef>
#include <initializer_list>
#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

using Points = std::vector<Vec3>;

// Polygons of a hull, one after the other.
class Polygons {
 public:
  struct Face {
    Vec3 normal;
    double offset;
    int first, count;  // corners
  };

  // The corners, anticlockwise seen from outside, are those of push_corner that follow.
  void push(const Vec3& normal, double offset) {
    faces_.push_back({normal, offset, static_cast<int>(corners_.size()), 0});
  }
  void push_corner(int i) {
    corners_.push_back(i);
    ++faces_.back().count;
  }
  void push(const Vec3& normal, double offset, std::initializer_list<int> corners) {
    push(normal, offset);
    for (int i : corners) push_corner(i);
  }

  const std::vector<Face>& faces() const { return faces_; }
  const std::vector<int>& corners() const { return corners_; }
  int corner(const Face& face, int k) const { return corners_[face.first + k]; }

 private:
  std::vector<Face> faces_;
  std::vector<int> corners_;
};

class HullFaces {
 public:
  // Keeps references to both.
  HullFaces(const Points& points, const std::vector<coal::Triangle>& triangles);

  // The faces, largest triangle first; a face has all points in its plane as corners, but those inside of it or of its
  // sides. Raises `roughness` to how far corners lie below their plane [m].
  Polygons merged(double& roughness) const;
  // Each triangle as a face.
  Polygons single() const;

 private:
  const Points& points_;
  const std::vector<coal::Triangle>& triangles_;
  Vec3 center_;
  double size_;            // diagonal of the box around the points
  std::vector<int> same_;  // per point the first one at its place
};

}  // namespace contactvi

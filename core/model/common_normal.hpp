// A place where the surfaces of two solids face each other.
#pragma once

#include "model/tree.hpp"

namespace contactvi {

// A place p on the first surface and a place x on the second one, each in its own frame, whose normals are opposite to
// each other and along x - p.
struct CommonNormal {
  double gap;   // n . (x - p) with the outward normal n of the first surface [m], negative where they overlap
  Vec3 normal;  // n, in the frame of the first surface
  Vec3 first, second;
  // Along the least curved way the surfaces keep their distance, as a cylinder along another one.
  bool is_flat;
  int part = 0;  // of the second surface, where that has several
};

}  // namespace contactvi

// A point where two bodies may touch, and the gradient of its gap.
#pragma once

#include "placement.hpp"

namespace contactvi {

// World frame. normal points from body a to body b; gap = (point_b - point_a).normal, negative in penetration.
struct Contact {
  double gap;
  Vec3 normal;
  Vec3 point_a, point_b;
  int body_a, body_b;  // engine joints, -1: world
};

// W = d(gap)/dq = n^T (J_B(x_B) - J_A(x_A)) in engine coordinates, shape (nv,). at: the placements at the same q.
void gap_gradient(const Tree& tree, const Placements& at, const Contact& contact, VecRef W);

}  // namespace contactvi

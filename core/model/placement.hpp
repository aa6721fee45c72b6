// Poses of the bodies in their parents and in the world, for contact geometry and potentials.
#pragma once

#include <vector>

#include "model/tree.hpp"

namespace contactvi {

struct Placements {
  explicit Placements(const Tree& tree);
  std::vector<Mat3> R;  // body frame in its parent's
  std::vector<Vec3> r;
  std::vector<Mat3> R_W;  // body frame in the world
  std::vector<Vec3> p_W;
};

// Pose of one body at q, shape (nq,), whose parent is placed.
void place_body(const Tree& tree, int body, const VecCRef& q, Placements& at);
// All poses at q, shape (nq,).
void place(const Tree& tree, const VecCRef& q, Placements& at);

// Potential energy of gravity [J].
double gravity_potential(const Tree& tree, const Placements& at);

}  // namespace contactvi

// Rows of the Jacobians of points and directions fixed to a body.
#pragma once

#include "model/placement.hpp"

namespace contactvi {

// W += sign n^T J(x): velocity along n of the point x fixed to the body (-1: the world, which adds nothing); n, x in
// the world frame. W: shape (nv,).
void add_point_row(const Tree& tree, const Placements& at, int body, const Vec3& x, const Vec3& n, double sign,
                   VecRef W);
// As add_point_row for each column of W, along the direction of the same number: the chain is walked once.
void add_point_rows(const Tree& tree, const Placements& at, int body, const Vec3& x, const Vec3* directions,
                    double sign, Eigen::Ref<MatX> W);
// W += sign n^T J_omega: angular velocity of the body about n.
void add_turn_row(const Tree& tree, const Placements& at, int body, const Vec3& n, double sign, VecRef W);

// World position of a point given in the body's frame, and world axes of a frame.
inline Vec3 world_point(const Placements& at, int body, const Vec3& p_B) {
  return body < 0 ? p_B : Vec3(at.p_W[body] + at.R_W[body] * p_B);
}
inline Mat3 world_axes(const Placements& at, int body, const Mat3& R_B) {
  return body < 0 ? R_B : Mat3(at.R_W[body] * R_B);
}

}  // namespace contactvi

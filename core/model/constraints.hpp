// Constraints phi(q, t) = 0: loops, joints that follow others, prescribed motions of joints and lengths.
//
//   kPoint       x_b - x_a, world axes                                                     3 rows
//   kDistance    |x_b - x_a| - l                                                           1
//   kWeld        R_a^T (x_b - x_a); 2 vec of the quaternion of R_a^T R_b (w >= 0)          6 (moving_frame.hpp, too)
//   kScrew       d_x, d_y; x_a.z_b, y_a.z_b; d_z - offset - pitch theta, d = R_a^T (x_b - x_a), theta the turn of b
//                about z_a, with the whole turns that d_z amounts to (pitch 0: a hinge)      5
//   kEquality    q_b - sum_k c_k q_a^k                                                     1
//   kPrescribed  q_b - r(t), for (cos, sin) joints modulo whole turns                      1
#pragma once

#include <vector>

#include "model/moving_frame.hpp"
#include "model/placement.hpp"

namespace contactvi {

// Number of rows that a constraint of this kind has.
int constraint_rows(ConstraintKind kind);

// Values of prescribed motions at one time, which are not asked for again: users' functions may cost more than a step.
struct MotionValues {
  struct Value {
    bool known = false;
    std::array<double, 3> signal{};
    FrameMotion frame{};
  };
  std::vector<Value> of;  // per constraint
  // Asks for all those of the time t that are not known.
  void ask(const std::vector<Constraint>& constraints, double t);
  // Those so much later [s], where the motion has an acceleration: to the second order.
  MotionValues later(const std::vector<Constraint>& constraints, double dt) const;
  void forget() {
    for (Value& value : of) value.known = false;
  }
};

// Residuals phi (m,), their gradients as the columns of W (nv, m), engine coordinates, and their rates at fixed q,
// d phi/dt (m,). at: the placements at q. motions: those of the time t, of which it asks for those not known yet.
void evaluate_constraints(const Tree& tree, const Placements& at, const VecCRef& q, double t, VecRef phi,
                          Eigen::Ref<MatX> W, VecRef rate);
void evaluate_constraints(const Tree& tree, const Placements& at, const VecCRef& q, double t, VecRef phi,
                          Eigen::Ref<MatX> W, VecRef rate, MotionValues& motions);
// Those of the constraints as they were given, couplings of joints among them.
void evaluate_given_constraints(const Tree& tree, const Placements& at, const VecCRef& q, double t, VecRef phi,
                                Eigen::Ref<MatX> W, VecRef rate);

}  // namespace contactvi

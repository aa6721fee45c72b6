#include "model/constraints.hpp"

#include <cmath>

#include "base/tolerances.hpp"
#include "model/point_jacobian.hpp"

namespace contactvi {

namespace {

// One constraint's rows while they are written.
struct Rows {
  const Tree& tree;
  const Placements& at;
  VecRef phi;
  Eigen::Ref<MatX> W;
  VecRef rate;
  int row;

  // Gradient of the current row: velocity of b's point at x relative to a's, along n.
  void point(const Constraint& c, const Vec3& x, const Vec3& n) {
    add_point_row(tree, at, c.b.body, x, n, 1.0, W.col(row));
    add_point_row(tree, at, c.a.body, x, n, -1.0, W.col(row));
  }
  // Gradient of the current row: angular velocity of b relative to a about n.
  void turn(const Constraint& c, const Vec3& n) {
    add_turn_row(tree, at, c.b.body, n, 1.0, W.col(row));
    add_turn_row(tree, at, c.a.body, n, -1.0, W.col(row));
  }
};

void point(const Constraint& c, const Vec3& x_a, const Vec3& x_b, Rows& rows) {
  for (int k = 0; k < 3; ++k, ++rows.row) {
    rows.phi[rows.row] = x_b[k] - x_a[k];
    add_point_row(rows.tree, rows.at, c.b.body, x_b, Vec3::Unit(k), 1.0, rows.W.col(rows.row));
    add_point_row(rows.tree, rows.at, c.a.body, x_a, Vec3::Unit(k), -1.0, rows.W.col(rows.row));
  }
}

void distance(const Constraint& c, const MotionValues::Value& motion, const Vec3& x_a, const Vec3& x_b, Rows& rows) {
  const Vec3 d = x_b - x_a;
  const double length = d.norm();
  const Vec3 u = length > kLeastDivisor ? Vec3(d / length) : Vec3(Vec3::UnitZ());
  double wanted = c.numbers.empty() ? 0.0 : c.numbers[0];
  if (c.signal) {
    wanted = motion.signal[0];
    rows.rate[rows.row] = -motion.signal[1];
  }
  rows.phi[rows.row] = length - wanted;
  add_point_row(rows.tree, rows.at, c.b.body, x_b, u, 1.0, rows.W.col(rows.row));
  add_point_row(rows.tree, rows.at, c.a.body, x_a, u, -1.0, rows.W.col(rows.row));
  ++rows.row;
}

// motion: of the frame of a, where that moves in the world; else null.
void weld(const Constraint& c, const FrameMotion* motion, const Mat3& R_a, const Vec3& x_a, const Mat3& R_b,
          const Vec3& x_b, Rows& rows) {
  // The residual is in a's axes, which turn: its rate is the relative velocity of a's point that is now at x_b.
  for (int k = 0; k < 3; ++k, ++rows.row) {
    rows.phi[rows.row] = R_a.col(k).dot(x_b - x_a);
    rows.point(c, x_b, R_a.col(k));
    if (motion) rows.rate[rows.row] = -R_a.col(k).dot(motion->v_W + motion->omega_W.cross(x_b - x_a));
  }
  Quat turn(Mat3(R_a.transpose() * R_b));
  if (turn.w() < 0.0) turn.coeffs() = -turn.coeffs();
  // d(2 vec)/dt = (w - vec x) omega, with the angular velocity omega of b relative to a in a's axes.
  const Mat3 B = turn.w() * Mat3::Identity() - skew(turn.vec());
  for (int k = 0; k < 3; ++k, ++rows.row) {
    const Vec3 n = R_a * B.row(k).transpose();
    rows.phi[rows.row] = 2.0 * turn.vec()[k];
    rows.turn(c, n);
    if (motion) rows.rate[rows.row] = -n.dot(motion->omega_W);
  }
}

void screw(const Constraint& c, const Mat3& R_a, const Vec3& x_a, const Mat3& R_b, const Vec3& x_b, Rows& rows) {
  const Vec3 d = R_a.transpose() * (x_b - x_a), z_b = R_b.col(2);
  for (int k = 0; k < 2; ++k, ++rows.row) {
    rows.phi[rows.row] = d[k];
    rows.point(c, x_b, R_a.col(k));
  }
  for (int k = 0; k < 2; ++k, ++rows.row) {
    rows.phi[rows.row] = R_a.col(k).dot(z_b);
    rows.turn(c, z_b.cross(R_a.col(k)));
  }
  const double pitch = c.numbers[0], along = d.z() - c.numbers[1];
  double residual = along;
  if (pitch != 0.0) {
    const double theta = std::atan2(R_a.col(1).dot(R_b.col(0)), R_a.col(0).dot(R_b.col(0)));
    residual = pitch * std::remainder(along / pitch - theta, kTwoPi);
  }
  rows.phi[rows.row] = residual;
  rows.point(c, x_b, R_a.col(2));
  rows.turn(c, -pitch * R_a.col(2));
  ++rows.row;
}

void equality(const Constraint& c, const VecCRef& q, Rows& rows) {
  const Joint &a = rows.tree.joints[c.joint_a], &b = rows.tree.joints[c.joint_b];
  double value = 0.0, slope = 0.0;
  for (auto k = c.numbers.rbegin(); k != c.numbers.rend(); ++k) {
    slope = slope * q[a.iq] + value;
    value = value * q[a.iq] + *k;
  }
  rows.phi[rows.row] = q[b.iq] - value;
  rows.W(b.iv, rows.row) += 1.0;
  rows.W(a.iv, rows.row) -= slope;
  ++rows.row;
}

void prescribed(const Constraint& c, const MotionValues::Value& motion, const VecCRef& q, Rows& rows) {
  const Joint& b = rows.tree.joints[c.joint_b];
  const auto& driven = motion.signal;
  rows.phi[rows.row] = b.type == JointType::kContinuous
                           ? std::remainder(std::atan2(q[b.iq + 1], q[b.iq]) - driven[0], kTwoPi)
                           : q[b.iq] - driven[0];
  rows.W(b.iv, rows.row) += 1.0;
  rows.rate[rows.row] = -driven[1];
  ++rows.row;
}

const MotionValues::Value& motion_of(const Constraint& c, double t, MotionValues::Value& value) {
  if (value.known) return value;
  if (const MovingFrame* frame = moving_frame(c))
    value.frame = frame->at(t);
  else if (c.signal)
    value.signal = c.signal(t);
  value.known = true;
  return value;
}

void evaluate(const std::vector<Constraint>& constraints, const VecCRef& q, double t, Rows& rows,
              MotionValues& motions) {
  const Placements& at = rows.at;
  rows.W.setZero();
  rows.rate.setZero();
  motions.of.resize(constraints.size());
  for (std::size_t k = 0; k < constraints.size(); ++k) {
    const Constraint& c = constraints[k];
    rows.row = c.row;
    if (c.kind == ConstraintKind::kEquality) {
      equality(c, q, rows);
      continue;
    }
    if (c.kind == ConstraintKind::kPrescribed) {
      prescribed(c, motion_of(c, t, motions.of[k]), q, rows);
      continue;
    }
    const Vec3 x_a = world_point(at, c.a.body, c.a.p_B), x_b = world_point(at, c.b.body, c.b.p_B);
    if (c.kind == ConstraintKind::kPoint) {
      point(c, x_a, x_b, rows);
    } else if (c.kind == ConstraintKind::kDistance) {
      distance(c, motion_of(c, t, motions.of[k]), x_a, x_b, rows);
    } else {
      const Mat3 R_a = world_axes(at, c.a.body, c.a.R_B), R_b = world_axes(at, c.b.body, c.b.R_B);
      if (moving_frame(c) != nullptr) {
        const FrameMotion& motion = motion_of(c, t, motions.of[k]).frame;
        weld(c, &motion, motion.R_W, motion.p_W, R_b, x_b, rows);
      } else if (c.kind == ConstraintKind::kWeld) {
        weld(c, nullptr, R_a, x_a, R_b, x_b, rows);
      } else {
        screw(c, R_a, x_a, R_b, x_b, rows);
      }
    }
  }
}

}  // namespace

void MotionValues::ask(const std::vector<Constraint>& constraints, double t) {
  of.resize(constraints.size());
  for (std::size_t k = 0; k < of.size(); ++k) motion_of(constraints[k], t, of[k]);
}

MotionValues MotionValues::later(const std::vector<Constraint>& constraints, double dt) const {
  MotionValues found;
  found.of.resize(of.size());
  for (std::size_t k = 0; k < of.size(); ++k) {
    const auto& [x, v, a] = of[k].signal;
    if (!of[k].known || moving_frame(constraints[k]) != nullptr) continue;
    found.of[k].signal = {x + dt * v + 0.5 * dt * dt * a, v + dt * a, a};
    found.of[k].known = true;
  }
  return found;
}

int constraint_rows(ConstraintKind kind) {
  switch (kind) {
    case ConstraintKind::kPoint:
      return 3;
    case ConstraintKind::kWeld:
      return 6;
    case ConstraintKind::kScrew:
      return 5;
    default:
      return 1;
  }
}

void evaluate_constraints(const Tree& tree, const Placements& at, const VecCRef& q, double t, VecRef phi,
                          Eigen::Ref<MatX> W, VecRef rate) {
  MotionValues motions;
  evaluate_constraints(tree, at, q, t, phi, W, rate, motions);
}

void evaluate_constraints(const Tree& tree, const Placements& at, const VecCRef& q, double t, VecRef phi,
                          Eigen::Ref<MatX> W, VecRef rate, MotionValues& motions) {
  Rows rows{tree, at, phi, W, rate, 0};
  evaluate(tree.elements.constraints, q, t, rows, motions);
}

void evaluate_given_constraints(const Tree& tree, const Placements& at, const VecCRef& q, double t, VecRef phi,
                                Eigen::Ref<MatX> W, VecRef rate) {
  Rows rows{tree, at, phi, W, rate, 0};
  MotionValues motions;
  evaluate(tree.elements.given_constraints, q, t, rows, motions);
}

}  // namespace contactvi

#include "model/constraint_tangent.hpp"

#include "base/differences.hpp"
#include "base/tolerances.hpp"
#include "model/moving_frame.hpp"
#include "model/point_jacobian.hpp"

namespace contactvi {

namespace {

const Vec3 kNone = Vec3::Zero();
constexpr double kTimeStep = 3e-4;  // [s] of differences of the velocity of a frame that the user moves

// One constraint's rows while their changes are written.
struct TangentRows {
  const BodyTwists& twists;
  const Constraint& c;
  const FrameMotion* frame;  // of a, where the user moves it; else null
  double dt;
  Eigen::Ref<MatX> dW;
  int row;

  Vec3 point_a() const { return world_point(twists.placements(), c.a.body, c.a.p_B); }
  Vec3 point_b() const { return world_point(twists.placements(), c.b.body, c.b.p_B); }
  Mat3 axes_a() const {
    return frame != nullptr ? frame->R_W : Mat3(world_axes(twists.placements(), c.a.body, c.a.R_B));
  }
  Mat3 axes_b() const { return world_axes(twists.placements(), c.b.body, c.b.R_B); }
  Vec3 turn_a() const { return frame != nullptr ? Vec3(dt * frame->omega_W) : twists.turn(c.a.body); }
  Vec3 turn_b() const { return twists.turn(c.b.body); }

  // Velocity along n of the point of `body` that is now at x, which is fixed to the body `with`.
  void point(int body, int with, const Vec3& x, const Vec3& n, const Vec3& dn, double sign) {
    twists.add_wrench(body, x, twists.velocity(with, x), sign * n, sign * dn, kNone, kNone, dW.col(row));
  }
  // Velocity of b's point at x relative to a's point there, along n.
  void relative(const Vec3& x, const Vec3& n, const Vec3& dn) {
    point(c.b.body, c.b.body, x, n, dn, 1.0);
    point(c.a.body, c.b.body, x, n, dn, -1.0);
  }
  // Angular velocity of b relative to a about n.
  void turn(const Vec3& n, const Vec3& dn) {
    twists.add_wrench(c.b.body, kNone, kNone, kNone, kNone, n, dn, dW.col(row));
    twists.add_wrench(c.a.body, kNone, kNone, kNone, kNone, -n, -dn, dW.col(row));
  }
};

void point(TangentRows& rows) {
  for (int k = 0; k < 3; ++k, ++rows.row) {
    rows.point(rows.c.b.body, rows.c.b.body, rows.point_b(), Vec3::Unit(k), kNone, 1.0);
    rows.point(rows.c.a.body, rows.c.a.body, rows.point_a(), Vec3::Unit(k), kNone, -1.0);
  }
}

void distance(TangentRows& rows) {
  const Vec3 x_a = rows.point_a(), x_b = rows.point_b(), d = x_b - x_a;
  const double length = d.norm();
  const bool known = length > kLeastDivisor;
  const Vec3 u = known ? Vec3(d / length) : Vec3(Vec3::UnitZ());
  const Vec3 moved = rows.twists.velocity(rows.c.b.body, x_b) - rows.twists.velocity(rows.c.a.body, x_a);
  const Vec3 du = known ? Vec3((moved - u * u.dot(moved)) / length) : kNone;
  rows.point(rows.c.b.body, rows.c.b.body, x_b, u, du, 1.0);
  rows.point(rows.c.a.body, rows.c.a.body, x_a, u, du, -1.0);
  ++rows.row;
}

void weld(TangentRows& rows) {
  const Mat3 R_a = rows.axes_a();
  const Vec3 x_b = rows.point_b(), turn_a = rows.turn_a();
  for (int k = 0; k < 3; ++k, ++rows.row) rows.relative(x_b, R_a.col(k), turn_a.cross(R_a.col(k)));
  Quat turn(Mat3(R_a.transpose() * rows.axes_b()));
  if (turn.w() < 0.0) turn.coeffs() = -turn.coeffs();
  const Vec3 omega = R_a.transpose() * (rows.turn_b() - turn_a);
  const double dw = -0.5 * turn.vec().dot(omega);
  const Vec3 dvec = 0.5 * (turn.w() * omega - turn.vec().cross(omega));
  const Mat3 B = turn.w() * Mat3::Identity() - skew(turn.vec()), dB = dw * Mat3::Identity() - skew(dvec);
  for (int k = 0; k < 3; ++k, ++rows.row) {
    const Vec3 n = R_a * B.row(k).transpose();
    rows.turn(n, turn_a.cross(n) + R_a * dB.row(k).transpose());
  }
}

void screw(TangentRows& rows) {
  const Mat3 R_a = rows.axes_a();
  const Vec3 z_b = rows.axes_b().col(2), x_b = rows.point_b(), turn_a = rows.turn_a(), dz_b = rows.turn_b().cross(z_b);
  for (int k = 0; k < 2; ++k, ++rows.row) rows.relative(x_b, R_a.col(k), turn_a.cross(R_a.col(k)));
  for (int k = 0; k < 2; ++k, ++rows.row) {
    const Vec3 n = R_a.col(k), dn = turn_a.cross(n);
    rows.turn(z_b.cross(n), dz_b.cross(n) + z_b.cross(dn));
  }
  const Vec3 z_a = R_a.col(2), dz_a = turn_a.cross(z_a);
  const double pitch = rows.c.numbers[0];
  rows.relative(x_b, z_a, dz_a);
  rows.turn(-pitch * z_a, -pitch * dz_a);
  ++rows.row;
}

// The slope of q_b - sum_k c_k q_a^k in q_a.
void equality(const Tree& tree, const VecCRef& q, const VecCRef& dq, TangentRows& rows) {
  const Joint& a = tree.joints[rows.c.joint_a];
  double value = 0.0, slope = 0.0, bend = 0.0;  // bend: half of the second derivative
  for (auto k = rows.c.numbers.rbegin(); k != rows.c.numbers.rend(); ++k) {
    bend = bend * q[a.iq] + slope;
    slope = slope * q[a.iq] + value;
    value = value * q[a.iq] + *k;
  }
  rows.dW(a.iv, rows.row) -= 2.0 * bend * dq[a.iv];
  ++rows.row;
}

}  // namespace

ConstraintTangent::ConstraintTangent(const Tree& tree)
    : tree_(&tree),
      twists_(tree),
      phi_(tree.elements.constraint_rows),
      rate_(tree.elements.constraint_rows),
      acceleration_(tree.elements.constraint_rows),
      W_(tree.nv, tree.elements.constraint_rows),
      W_rate_(MatX::Zero(tree.nv, tree.elements.constraint_rows)),
      frames_(tree.elements.constraints.size()) {
  for (const Constraint& c : tree.elements.constraints) any_frame_ |= moving_frame(c) != nullptr;
}

void ConstraintTangent::take(const VecCRef& q, double t) {
  q_ = q;
  twists_.place(q);
  evaluate_constraints(*tree_, twists_.placements(), q, t, phi_, W_, rate_);
  acceleration_.setZero();
  const std::vector<Constraint>& all = tree_->elements.constraints;
  for (std::size_t k = 0; k < all.size(); ++k) {
    if (moving_frame(all[k]) != nullptr)
      take_frame(all[k], t, frames_[k]);
    else if (all[k].signal)
      acceleration_[all[k].row] = -all[k].signal(t)[2];
  }
  if (any_frame_) change(VecX::Zero(tree_->nv), 1.0, W_rate_);
}

// The motion of the frame, and the second derivatives of the residuals by time: with the angular velocity Omega of b
// relative to the frame, in its axes, those of 2 vec are (w - vec x) Omega' + (w' - vec' x) Omega.
void ConstraintTangent::take_frame(const Constraint& c, double t, Frame& frame) {
  const MovingFrame& moving = *moving_frame(c);
  frame = {moving.at(t), kNone, kNone};
  for (const auto& [count, weight] : kDifference) {
    const FrameMotion near = moving.at(t + count * kTimeStep);
    frame.a_W += weight / (kDifferenceParts * kTimeStep) * near.v_W;
    frame.alpha_W += weight / (kDifferenceParts * kTimeStep) * near.omega_W;
  }
  const FrameMotion& at = frame.at;
  const Vec3 d = world_point(twists_.placements(), c.b.body, c.b.p_B) - at.p_W, speed = at.v_W + at.omega_W.cross(d),
             rest = frame.a_W + frame.alpha_W.cross(d) - at.omega_W.cross(at.v_W);
  for (int k = 0; k < 3; ++k)
    acceleration_[c.row + k] = -at.omega_W.cross(at.R_W.col(k)).dot(speed) - at.R_W.col(k).dot(rest);
  Quat turn(Mat3(at.R_W.transpose() * world_axes(twists_.placements(), c.b.body, c.b.R_B)));
  if (turn.w() < 0.0) turn.coeffs() = -turn.coeffs();
  const Vec3 omega = -(at.R_W.transpose() * at.omega_W), alpha = -(at.R_W.transpose() * frame.alpha_W),
             dvec = 0.5 * (turn.w() * omega - turn.vec().cross(omega));
  acceleration_.segment<3>(c.row + 3) =
      turn.w() * alpha - turn.vec().cross(alpha) - 0.5 * turn.vec().dot(omega) * omega - dvec.cross(omega);
}

VecX ConstraintTangent::turning(const VecCRef& v) {
  turned_.resize(W_.rows(), W_.cols());
  change(v, 1.0, turned_);
  return turned_.transpose() * v + rate_change(v, 1.0);
}

void ConstraintTangent::change(const VecCRef& dq, double dt, Eigen::Ref<MatX> dW) {
  dW.setZero();
  twists_.move(dq);
  const std::vector<Constraint>& all = tree_->elements.constraints;
  for (std::size_t k = 0; k < all.size(); ++k) {
    const Constraint& c = all[k];
    TangentRows rows{twists_, c, moving_frame(c) != nullptr ? &frames_[k].at : nullptr, dt, dW, c.row};
    switch (c.kind) {
      case ConstraintKind::kPoint:
        point(rows);
        break;
      case ConstraintKind::kDistance:
        distance(rows);
        break;
      case ConstraintKind::kWeld:
        weld(rows);
        break;
      case ConstraintKind::kScrew:
        screw(rows);
        break;
      case ConstraintKind::kEquality:
        equality(*tree_, q_, dq, rows);
        break;
      case ConstraintKind::kPrescribed:
        break;
    }
  }
}

}  // namespace contactvi

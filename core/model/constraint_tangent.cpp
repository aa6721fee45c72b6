#include "model/constraint_tangent.hpp"

#include "base/refusal.hpp"
#include "base/tolerances.hpp"
#include "model/moving_frame.hpp"
#include "model/point_jacobian.hpp"

namespace contactvi {

namespace {

const Vec3 kNone = Vec3::Zero();

// One constraint's rows while their changes are written.
struct Rows {
  const BodyTwists& twists;
  const Constraint& c;
  Eigen::Ref<MatX> dW;
  int row;

  Vec3 point_a() const { return world_point(twists.placements(), c.a.body, c.a.p_B); }
  Vec3 point_b() const { return world_point(twists.placements(), c.b.body, c.b.p_B); }
  Mat3 axes_a() const { return world_axes(twists.placements(), c.a.body, c.a.R_B); }
  Mat3 axes_b() const { return world_axes(twists.placements(), c.b.body, c.b.R_B); }
  Vec3 turn_a() const { return twists.turn(c.a.body); }
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

void point(Rows& rows) {
  for (int k = 0; k < 3; ++k, ++rows.row) {
    rows.point(rows.c.b.body, rows.c.b.body, rows.point_b(), Vec3::Unit(k), kNone, 1.0);
    rows.point(rows.c.a.body, rows.c.a.body, rows.point_a(), Vec3::Unit(k), kNone, -1.0);
  }
}

void distance(Rows& rows) {
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

void weld(Rows& rows) {
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

void screw(Rows& rows) {
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
void equality(const Tree& tree, const VecCRef& q, const VecCRef& dq, Rows& rows) {
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
      W_(tree.nv, tree.elements.constraint_rows) {
  for (const Constraint& c : tree.elements.constraints)
    if (moving_frame(c))
      throw Refusal("'" + c.name + "' has no derivatives that are known",
                    "constraints whose gradients do not depend on time", "the prescribed pose of a body",
                    "Prescribe the joints that move the body");
}

void ConstraintTangent::take(const VecCRef& q, double t) {
  q_ = q;
  twists_.place(q);
  evaluate_constraints(*tree_, twists_.placements(), q, t, phi_, W_, rate_);
  acceleration_.setZero();
  for (const Constraint& c : tree_->elements.constraints)
    if (c.signal) acceleration_[c.row] = -c.signal(t)[2];
}

void ConstraintTangent::change(const VecCRef& dq, Eigen::Ref<MatX> dW) {
  dW.setZero();
  twists_.move(dq);
  for (const Constraint& c : tree_->elements.constraints) {
    Rows rows{twists_, c, dW, c.row};
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

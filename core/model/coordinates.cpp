#include "model/coordinates.hpp"

#include <cmath>

namespace contactvi {

namespace {

void rotate(const SplitJoint& split, const VecCRef& q, bool to_world, VecRef w) {
  if (split.planar) {
    const double c = q[split.iq + 2], s = (to_world ? 1.0 : -1.0) * q[split.iq + 3];
    const double x = w[split.iv], y = w[split.iv + 1];
    w[split.iv] = c * x - s * y;
    w[split.iv + 1] = s * x + c * y;
    return;
  }
  const int i = split.iq + 3;
  const Quat quat(q[i + 3], q[i], q[i + 1], q[i + 2]);
  const Vec3 linear = w.segment<3>(split.iv);
  w.segment<3>(split.iv) = to_world ? Vec3(quat * linear) : Vec3(quat.conjugate() * linear);
}

// With R the body's axes and dR = R [turn]: d(R x) = R (dx + turn x x), d(R^T y) = R^T dy - turn x (R^T y).
void add_turn(const SplitJoint& split, const VecCRef& dq, double sign, const VecCRef& x, VecRef dx) {
  const int iv = split.iv;
  if (split.planar) {
    const double turn = sign * dq[iv + 2];
    dx[iv] -= turn * x[iv + 1];
    dx[iv + 1] += turn * x[iv];
    return;
  }
  const Vec3 turn = dq.segment<3>(iv + 3), linear = x.segment<3>(iv);
  dx.segment<3>(iv) += sign * turn.cross(linear);
}

// The transpose of add_turn in dq.
void add_turn_adjoint(const SplitJoint& split, double sign, const VecCRef& x, const VecCRef& lx, VecRef lq) {
  const int iv = split.iv;
  if (split.planar) {
    lq[iv + 2] += sign * (x[iv] * lx[iv + 1] - x[iv + 1] * lx[iv]);
    return;
  }
  const Vec3 linear = x.segment<3>(iv), bar = lx.segment<3>(iv);
  lq.segment<3>(iv + 3) += sign * linear.cross(bar);
}

}  // namespace

Mat3 split_axes(const SplitJoint& split, const VecCRef& q0, const VecCRef& X) {
  const int iq = split.iq, iv = split.iv;
  if (!split.planar) {
    const Quat quat(q0[iq + 6], q0[iq + 3], q0[iq + 4], q0[iq + 5]);
    return (quat * so3_exp(Vec3(X.segment<3>(iv + 3)))).toRotationMatrix();
  }
  const double c = std::cos(X[iv + 2]), s = std::sin(X[iv + 2]), c0 = q0[iq + 2], s0 = q0[iq + 3];
  Mat3 R = Mat3::Identity();
  R(0, 0) = R(1, 1) = c0 * c - s0 * s;
  R(1, 0) = s0 * c + c0 * s;
  R(0, 1) = -R(1, 0);
  return R;
}

void public_to_engine_tangent(const Tree& tree, const VecCRef& q, const VecCRef& dq, const VecCRef& w, VecRef dw) {
  for (const SplitJoint& split : tree.split) add_turn(split, dq, 1.0, w, dw);
  public_to_engine(tree, q, dw);
}

void engine_to_public_tangent(const Tree& tree, const VecCRef& q, const VecCRef& dq, const VecCRef& w, VecRef dw) {
  if (tree.split.empty()) return;
  VecX turned = w;
  engine_to_public(tree, q, turned);
  engine_to_public(tree, q, dw);
  for (const SplitJoint& split : tree.split) add_turn(split, dq, -1.0, turned, dw);
}

// The rotations are orthogonal: the transpose of one direction is the other.
void public_to_engine_adjoint(const Tree& tree, const VecCRef& q, const VecCRef& w, VecRef lw, VecRef lq) {
  engine_to_public(tree, q, lw);
  for (const SplitJoint& split : tree.split) add_turn_adjoint(split, 1.0, w, lw, lq);
}

void engine_to_public_adjoint(const Tree& tree, const VecCRef& q, const VecCRef& w, VecRef lw, VecRef lq) {
  if (tree.split.empty()) return;
  VecX turned = w;
  engine_to_public(tree, q, turned);
  for (const SplitJoint& split : tree.split) add_turn_adjoint(split, -1.0, turned, lw, lq);
  public_to_engine(tree, q, lw);
}

void public_to_engine(const Tree& tree, const VecCRef& q, VecRef w) {
  for (const SplitJoint& split : tree.split) rotate(split, q, true, w);
}

void engine_to_public(const Tree& tree, const VecCRef& q, VecRef w) {
  for (const SplitJoint& split : tree.split) rotate(split, q, false, w);
}

}  // namespace contactvi

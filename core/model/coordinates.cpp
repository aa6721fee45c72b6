#include "model/coordinates.hpp"

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

}  // namespace

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

void public_to_engine(const Tree& tree, const VecCRef& q, VecRef w) {
  for (const SplitJoint& split : tree.split) rotate(split, q, true, w);
}

void engine_to_public(const Tree& tree, const VecCRef& q, VecRef w) {
  for (const SplitJoint& split : tree.split) rotate(split, q, false, w);
}

}  // namespace contactvi

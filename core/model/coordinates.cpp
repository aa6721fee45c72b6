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

}  // namespace

void public_to_engine(const Tree& tree, const VecCRef& q, VecRef w) {
  for (const SplitJoint& split : tree.split) rotate(split, q, true, w);
}

void engine_to_public(const Tree& tree, const VecCRef& q, VecRef w) {
  for (const SplitJoint& split : tree.split) rotate(split, q, false, w);
}

}  // namespace contactvi

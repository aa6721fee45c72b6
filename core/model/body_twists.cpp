#include "model/body_twists.hpp"

namespace contactvi {

BodyTwists::BodyTwists(const Tree& tree)
    : tree_(&tree),
      at_(tree),
      moved_(tree.joints.size()),
      speed_(tree.joints.size()),
      speed_moved_(tree.joints.size()) {}

Twist BodyTwists::axis(int joint, int d) const {
  const Mat3& R = at_.R_W[joint];
  const Vec3& p = at_.p_W[joint];
  switch (tree_->joints[joint].type) {
    case JointType::kRevolute:
    case JointType::kContinuous:
      return {R.col(2), p.cross(R.col(2))};
    case JointType::kPrismatic:
      return {Vec3::Zero(), R.col(2)};
    case JointType::kHelical:
      return {R.col(2), p.cross(R.col(2)) + tree_->joints[joint].pitch * R.col(2)};
    case JointType::kTranslation:
      return {Vec3::Zero(), R.col(d)};
    default:
      return {R.col(d), p.cross(R.col(d))};
  }
}

void BodyTwists::move(const VecCRef& dq) {
  for (int i = 0; i < static_cast<int>(tree_->joints.size()); ++i) {
    const Joint& joint = tree_->joints[i];
    moved_[i] = joint.parent < 0 ? Twist{Vec3::Zero(), Vec3::Zero()} : moved_[joint.parent];
    for (int d = 0; d < joint.nv; ++d) moved_[i] = sum(moved_[i], scaled(dq[joint.iv + d], axis(i, d)));
  }
}

void BodyTwists::move(const VecCRef& v, const VecCRef& dq, const VecCRef& dv) {
  const Twist none = {Vec3::Zero(), Vec3::Zero()};
  move(dq);
  for (int i = 0; i < static_cast<int>(tree_->joints.size()); ++i) {
    const Joint& joint = tree_->joints[i];
    const bool root = joint.parent < 0;
    Twist own = none, rate = none;
    for (int d = 0; d < joint.nv; ++d) {
      const Twist S = axis(i, d);
      own = sum(own, scaled(v[joint.iv + d], S));
      rate = sum(rate, scaled(dv[joint.iv + d], S));
    }
    speed_[i] = root ? own : sum(speed_[joint.parent], own);
    const Twist turned = sum(cross(moved_[i], own), rate);
    speed_moved_[i] = root ? turned : sum(speed_moved_[joint.parent], turned);
  }
}

void BodyTwists::add_wrench(int body, const Vec3& x, const Vec3& dx, const Vec3& F, const Vec3& dF, const Vec3& T,
                            const Vec3& dT, VecRef df) const {
  const Vec3 N = x.cross(F) + T, dN = dx.cross(F) + x.cross(dF) + dT;
  for (int j = body; j >= 0; j = tree_->joints[j].parent) {
    const Joint& joint = tree_->joints[j];
    const Twist& V = moved_[j];
    const Vec3 n = dN + N.cross(V.ang) + F.cross(V.lin), f = dF + F.cross(V.ang);
    for (int d = 0; d < joint.nv; ++d) {
      const Twist S = axis(j, d);
      df[joint.iv + d] += S.ang.dot(n) + S.lin.dot(f);
    }
  }
}

}  // namespace contactvi

#include "step/force_curvature.hpp"

#include "lanes/lanes.hpp"
#include "model/coordinates.hpp"

namespace contactvi {

namespace {

#include "lanes/lane_math.hpp"

// The derivative of J_r(x)^-T y along dx.
Vec3 inverse_transpose_change(const Vec3& x, const Vec3& dx, const Vec3& y) {
  using D = Dual<double>;
  const V3<D> found = jacobian_inverse_transpose(rotation(V3<D>{{x[0], dx[0]}, {x[1], dx[1]}, {x[2], dx[2]}}),
                                                 V3<D>{{y[0], 0.0}, {y[1], 0.0}, {y[2], 0.0}});
  return {found.x.d, found.y.d, found.z.d};
}

// R^T y of a split joint, R the axes of its body and y a force, and what it changes by.
Vec3 turned_back(const SplitJoint& split, const MovingState& at, const VecCRef& y) {
  const Mat3 R = split_axes(split, at.q, VecX::Zero(at.v.size()));
  const int iv = split.iv;
  return R.transpose() * (split.planar ? Vec3(y[iv], y[iv + 1], 0.0) : Vec3(y.segment<3>(iv)));
}
Vec3 turned_back_change(const SplitJoint& split, const MovingState& at, const VecCRef& y) {
  const int iv = split.iv;
  const Vec3 turn = split.planar ? Vec3(0.0, 0.0, at.dq[iv + 2]) : Vec3(at.dq.segment<3>(iv + 3));
  return turned_back(split, at, y).cross(turn);
}

}  // namespace

ForceCurvature::ForceCurvature(const Tree& tree) : tree_(&tree), elements_(tree) {
  for (const Joint& joint : tree.joints)
    has_ball_springs_ |= joint.type == JointType::kSpherical && joint.stiffness != 0.0;
  any_ = has_ball_springs_ || !tree.split.empty() || elements_.any();
}

// The gradient of f_bar . R tau in a turn is tau x R^T f_bar.
void ForceCurvature::add_turn(const SplitJoint& split, const VecX& tau, const Vec3& force, VecRef lq) const {
  const int iv = split.iv;
  if (tau.size() == 0) return;
  if (split.planar) {
    lq[iv + 2] += tau[iv] * force[1] - tau[iv + 1] * force[0];
  } else {
    lq.segment<3>(iv + 3) += Vec3(tau.segment<3>(iv)).cross(force);
  }
}

void ForceCurvature::add(const MovingState& at, const VecX& tau, const VecX& dtau, const VecCRef& f_bar, VecRef lq,
                         VecRef lv) {
  elements_.add(at.time, at.q, at.v, at.dq, at.dv, f_bar, lq, lv);
  if (has_ball_springs_)
    for (const Joint& joint : tree_->joints) {
      if (joint.type != JointType::kSpherical || joint.stiffness == 0.0) continue;
      const Vec3 x = spring_deflection(*tree_, joint, at.q), bar = f_bar.segment<3>(joint.iv);
      const Vec3 dx = so3_right_jacobian_inverse(x) * at.dq.segment<3>(joint.iv);
      lq.segment<3>(joint.iv) -= joint.stiffness * inverse_transpose_change(x, dx, bar);
    }
  for (const SplitJoint& split : tree_->split) {
    add_turn(split, tau, turned_back_change(split, at, f_bar), lq);
    add_turn(split, dtau, turned_back(split, at, f_bar), lq);
  }
}

void ForceCurvature::add_inputs(const MovingState& at, const VecCRef& f_bar, VecRef ltau) const {
  for (const SplitJoint& split : tree_->split) {
    const int size = split.planar ? 2 : 3;
    ltau.segment(split.iv, size) += turned_back_change(split, at, f_bar).head(size);
  }
}

}  // namespace contactvi

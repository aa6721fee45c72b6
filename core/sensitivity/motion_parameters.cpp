#include "sensitivity/motion_parameters.hpp"

#include "base/differences.hpp"

namespace contactvi {

namespace {
// By which a joint moves between the instants of a difference [m; rad]: the error is the fourth power of it, and the
// rounding 1e-16 over it.
constexpr double kMotion = 1e-3;

// x + omega x y on the spherical joints, times a sign.
void add_turn(const Tree& tree, const VecX& omega, const VecX& y, double sign, VecX& x) {
  for (const Joint& joint : tree.joints) {
    if (joint.type != JointType::kSpherical) continue;
    const Vec3 w = omega.segment<3>(joint.iv), momentum = y.segment<3>(joint.iv);
    x.segment<3>(joint.iv) += sign * w.cross(momentum);
  }
}
}  // namespace

MotionParameters::MotionParameters(const Tree& tree)
    : tree_(&tree), model_(tree), node_(tree, model_, 1), tangent_(tree), adjoint_(tree) {}

void MotionParameters::take(const VecX& q, const VecX& v, const VecX& a, const Servo* servo) {
  q_ = q;
  v_ = v;
  node_.at(q);
  node_.set_servo(servo);
  for (int d = 0; d < tree_->nv; ++d) node_.v()[d * node_.padded()] = v[d];
  const double speed = 1.0 + v.cwiseAbs().maxCoeff(), rate = std::max(speed, a.cwiseAbs().maxCoeff() / speed);
  const double step = kMotion / rate;
  around_.clear();
  for (const auto& [count, weight] : kDifference) {
    Moment at{VecX(tree_->nq), v + count * step * a, weight / (kDifferenceParts * step)};
    integrate(*tree_, q, v, count * step, at.q);
    around_.push_back(std::move(at));
  }
}

void MotionParameters::change(const StepParameters& direction, VecX& dp, VecX& dforce) {
  const int n = tree_->nv;
  VecX dP = VecX::Zero(n), rate = dP, unused = dP;
  dforce.setZero(n);
  tangent_.add_state(q_, v_, direction, dP, dforce);
  tangent_.add_forces(node_, q_, 0, direction, dforce);
  for (const Moment& at : around_) {
    VecX P = VecX::Zero(n);
    tangent_.add_state(at.q, at.v, direction, P, unused);
    rate += at.weight * P;
  }
  add_turn(*tree_, v_, dP, 1.0, rate);
  dforce -= rate;
  dp = -dP;
}

void MotionParameters::add_gradient(const VecX& lp, const VecX& lforce, StepParameters& sums) {
  VecX lP = -lp;
  add_turn(*tree_, v_, lforce, 1.0, lP);
  adjoint_.add_state(q_, v_, lP, lforce, sums);
  adjoint_.add_forces(node_, q_, 0, lforce, sums);
  const VecX none = VecX::Zero(tree_->nv);
  for (const Moment& at : around_) adjoint_.add_state(at.q, at.v, -at.weight * lforce, none, sums);
}

}  // namespace contactvi

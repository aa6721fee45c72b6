#include "step/path.hpp"

#include <algorithm>
#include <cmath>

#include "base/tolerances.hpp"

namespace contactvi {

namespace {

constexpr double kChartEnd = 36.0;  // [rad^2] square of the turn up to which J^-1 is used; it is singular at 2 pi
// The error after raising as a share of the correction by it; the share grows, up to 1, with that of the correction in
// the motion.
constexpr double kSafety = 0.25, kCoarse = 10.0;

template <class Function>
void for_spherical(const Tree& tree, Function&& function) {
  if (tree.nq == tree.nv) return;  // no joint has a quaternion
  for (const Joint& joint : tree.joints)
    if (joint.type == JointType::kSpherical) function(joint.iv);
}

}  // namespace

void add_size(const Tree& tree, const VecCRef& v, double factor, VecRef sum) {
  sum += factor * v.cwiseAbs();
  for_spherical(tree, [&](int iv) {
    const Vec3 x = v.segment<3>(iv);
    sum.segment<3>(iv) += factor * (Vec3::Constant(x.norm()) - x.cwiseAbs());
  });
}

StepPath::StepPath(const Tree& tree, int stages)
    : tree_(&tree),
      stages_(stages),
      count_(stages),
      q0_(VecX::Zero(tree.nq)),
      coef_(MatX::Zero(tree.nv, stages + 2)),
      X_(tree.nv),
      rate_(tree.nv) {}

void StepPath::set(const VecCRef& q0, double h, const Eigen::Ref<const MatX>& rates) {
  q0_ = q0;
  h_ = h;
  raised_ = false;
  count_ = stages_;
  const GaussTable& table = gauss_table(stages_);
  constexpr Eigen::Index kSideBySide = 4;  // dofs, whose sums do not wait for each other
  const Eigen::Index nv = coef_.rows();
  for (Eigen::Index first = 0; first < nv; first += kSideBySide) {
    const Eigen::Index count = std::min(kSideBySide, nv - first);
    double rate[kMaxStages][kSideBySide];
    for (int j = 0; j < stages_; ++j)
      for (Eigen::Index d = 0; d < kSideBySide; ++d) rate[j][d] = rates(first + std::min(d, count - 1), j);
    for (int k = 0; k < stages_; ++k) {
      double sum[kSideBySide];
      for (Eigen::Index d = 0; d < kSideBySide; ++d) sum[d] = table.to_legendre[k][0] * rate[0][d];
      for (int j = 1; j < stages_; ++j)
        for (Eigen::Index d = 0; d < kSideBySide; ++d) sum[d] += table.to_legendre[k][j] * rate[j][d];
      for (Eigen::Index d = 0; d < count; ++d) coef_(first + d, k) = sum[d];
    }
  }
}

void StepPath::raise(const VecCRef& v0, const VecCRef& v1) {
  if (raised_) return;
  // What X' lacks at the ends, where the rates are v0 and J(X(1))^-1 v1, since J(0) = 1.
  auto missing0 = coef_.col(stages_), missing1 = coef_.col(stages_ + 1);
  chart_rate(0.0, X_);
  missing0 = v0 - X_;
  chart_rate(1.0, X_);
  missing1 = -X_;
  displacement(1.0, X_);
  rate_ = v1;
  for_spherical(*tree_, [&](int iv) {
    const Vec3 xi = X_.segment<3>(iv), v = v1.segment<3>(iv);
    const double angle2 = xi.squaredNorm();
    if (angle2 < kChartEnd) {
      rate_.segment<3>(iv) = so3_apply(xi, 0.5, so3_coefficients(angle2).inv_t, v);
    } else {
      rate_.segment<3>(iv) = -missing1.segment<3>(iv);
      missing0.segment<3>(iv).setZero();
    }
  });
  missing1 += rate_;
  // P_s(x)(a + b x) is a + b at x = 1 and (-1)^s (a - b) at -1; x P_s = ((s+1) P_{s+1} + s P_{s-1}) / (2s+1).
  const double sign = stages_ % 2 == 0 ? 1.0 : -1.0, s = stages_;
  X_ = 0.5 * (missing1 + sign * missing0);     // a
  rate_ = 0.5 * (missing1 - sign * missing0);  // b
  coef_.col(stages_) = X_;
  if (stages_ == 1) {
    coef_.col(2) = rate_;  // P_2 instead of x P_1: the mean, and so X(1), stays as it is
  } else {
    coef_.col(stages_ + 1) = ((s + 1) / (2 * s + 1)) * rate_;
    coef_.col(stages_ - 1) += (s / (2 * s + 1)) * rate_;
  }
  count_ = stages_ + 2;
  raised_ = true;
}

void StepPath::raise_by_half_step(const VecCRef& v0, const VecCRef& half_rate) {
  if (raised_) return;
  // X(tau) = tau h w(tau), w quadratic through v0, the half step's rate and the whole step's.
  coef_.col(2) = v0 + coef_.col(0) - 2.0 * half_rate;
  coef_.col(1) = coef_.col(0) - v0 + coef_.col(2);
  count_ = 3;
  raised_ = true;
}

void StepPath::lean(const VecCRef& v0) {
  if (raised_) return;
  coef_.col(1) = coef_.col(0) - v0;
  count_ = 2;
}

void StepPath::displacement(double tau, VecRef X) const {
  if (tau == 1.0) {  // the other integrals vanish
    X = h_ * coef_.col(0);
    return;
  }
  double I[kMaxStages + 2];
  legendre_integrals(tau, count_, I);
  X = (h_ * I[0]) * coef_.col(0);
  for (int k = 1; k < count_; ++k) X += (h_ * I[k]) * coef_.col(k);
}

void StepPath::chart_rate(double tau, VecRef rate) const {
  double P[kMaxStages + 2];
  legendre(2.0 * tau - 1.0, count_, P);
  rate = coef_.col(0);
  for (int k = 1; k < count_; ++k) rate += P[k] * coef_.col(k);
}

// Displacement of one joint, whose numbers begin at iv; I: integrals of Legendre's polynomials up to tau.
void StepPath::joint_displacement(const double* I, int iv, int nv, double* X) const {
  for (int d = 0; d < nv; ++d) {
    X[d] = (h_ * I[0]) * coef_(iv + d, 0);
    for (int k = 1; k < count_; ++k) X[d] += (h_ * I[k]) * coef_(iv + d, k);
  }
}

void StepPath::configuration(double tau, VecRef q) const {
  double I[kMaxStages + 2], X[3];
  legendre_integrals(tau, count_, I);
  for (const Joint& joint : tree_->joints) {
    joint_displacement(I, joint.iv, joint.nv, X);
    integrate_joint(joint, q0_, X, q);
  }
}

// v = J(X) X' of a spherical joint whose X' is in v.
void StepPath::turn_rate(const double* I, int iv, VecRef v) const {
  Vec3 xi;
  joint_displacement(I, iv, 3, xi.data());
  const Vec3 rate = v.segment<3>(iv);
  const So3Coefficients c = so3_coefficients(xi.squaredNorm());
  v.segment<3>(iv) = so3_apply(xi, -c.cos_t, c.cub_t, rate);
}

void StepPath::velocity(double tau, VecRef v) const {
  double I[kMaxStages + 2];
  legendre_integrals(tau, count_, I);
  chart_rate(tau, v);
  for_spherical(*tree_, [&](int iv) { turn_rate(I, iv, v); });
}

void StepPath::configuration(double tau, const std::vector<int>& joints, VecRef q) const {
  double I[kMaxStages + 2], X[3];
  legendre_integrals(tau, count_, I);
  for (int j : joints) {
    const Joint& joint = tree_->joints[j];
    joint_displacement(I, joint.iv, joint.nv, X);
    integrate_joint(joint, q0_, X, q);
  }
}

void StepPath::velocity(double tau, const std::vector<int>& joints, VecRef v) const {
  double I[kMaxStages + 2], P[kMaxStages + 2];
  legendre_integrals(tau, count_, I);
  legendre(2.0 * tau - 1.0, count_, P);
  for (int j : joints) {
    const Joint& joint = tree_->joints[j];
    for (int d = joint.iv; d < joint.iv + joint.nv; ++d) {
      v[d] = coef_(d, 0);
      for (int k = 1; k < count_; ++k) v[d] += P[k] * coef_(d, k);
    }
    if (joint.type == JointType::kSpherical) turn_rate(I, joint.iv, v);
  }
}

void StepPath::bound(VecRef bound) const {
  bound.setZero();
  for (int k = 0; k < count_; ++k) add_size(*tree_, coef_.col(k), 1.0, bound);
}

// The derivative of P_k is largest at the ends, k (k + 1) / 2, and 2 tau - 1 runs twice as fast as tau.
void StepPath::bend(VecRef bend) const {
  bend.setZero();
  for (int k = 1; k < count_; ++k) add_size(*tree_, coef_.col(k), k * (k + 1.0), bend);
}

void StepPath::doubt(VecRef doubt) const {
  doubt.setZero();
  if (raised_) {
    const double motion = coef_.leftCols(stages_).norm(),
                 share = coef_.col(stages_).norm() / std::max(motion, kLeastDivisor);
    const double safety = stages_ == 1 ? kSafety : std::min(1.0, kSafety + kCoarse * share);
    // With one stage the linear part is the acceleration, known from both ends.
    if (stages_ > 1) add_size(*tree_, coef_.col(stages_), safety, doubt);
    add_size(*tree_, coef_.col(stages_ + 1), 2.0 * safety, doubt);
    return;
  }
  add_size(*tree_, coef_.col(count_ - 1), 1.0, doubt);
  if (stages_ > 1) add_size(*tree_, coef_.col(stages_ - 2), kSafety, doubt);  // parity may make the last one vanish
}

}  // namespace contactvi

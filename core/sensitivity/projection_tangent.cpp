#include "sensitivity/projection_tangent.hpp"

namespace contactvi {

namespace {
// Of the inverse inertia that a row has without constraints: below it the constraints determine its motion.
constexpr double kImmobile = 1e-12;
}  // namespace

ProjectionTangent::ProjectionTangent(const Tree& tree)
    : constraints_(tree), dPhi_(tree.nv, tree.elements.constraint_rows) {}

void ProjectionTangent::take(StepEquations& equations, const VecX& q, double t) {
  constraints_.take(q, t);
  MinvPhi_ = constraints_.gradients();
  equations.solve_masses(MinvPhi_);
  system_.compute(constraints_.gradients().transpose() * MinvPhi_, constraints_.rows());
}

MatX ProjectionTangent::take_rows(const MatX& mu, MatX& W, MatX& Z) {
  mu_ = &mu;
  Z_ = &Z;
  const MatX before = W + constraints_.gradients() * mu, moved = Z + MinvPhi_ * mu;
  immobile_.assign(static_cast<std::size_t>(W.cols()), 0);
  for (Eigen::Index k = 0; k < W.cols(); ++k) {
    if (W.col(k).dot(Z.col(k)) > kImmobile * before.col(k).dot(moved.col(k))) continue;
    immobile_[static_cast<std::size_t>(k)] = 1;
    W.col(k).setZero();
    Z.col(k).setZero();
  }
  return before;
}

void ProjectionTangent::change(const VecX& dq, double dt, const MatX& turned, MatX& dW, VecX& offset) {
  constraints_.change(dq, dt, dPhi_);
  const VecX drate = constraints_.rate_change(dq, dt);
  dW.noalias() -= dPhi_ * *mu_;
  const MatX right = dPhi_.transpose() * *Z_ + MinvPhi_.transpose() * (dW - turned);
  const VecX none = VecX::Zero(constraints_.rows());
  VecX dmu;
  offset.resize(dW.cols());
  for (Eigen::Index k = 0; k < dW.cols(); ++k) {
    system_.solve(-right.col(k), none, dmu);
    dW.col(k).noalias() -= constraints_.gradients() * dmu;
    offset[k] = -dmu.dot(constraints_.rates()) - mu_->col(k).dot(drate);
    if (immobile_[static_cast<std::size_t>(k)] != 0) dW.col(k).setZero();
  }
}

// dmu has the part -K^+ Z_Phi^T dM Z', which acts on W' by -Phi dmu and on the speeds by -rate . dmu.
MatX ProjectionTangent::mass_gradient(const MatX& lW, const VecX& lspeeds) const {
  MatX found(lW.rows(), lW.cols());
  for (Eigen::Index k = 0; k < lW.cols(); ++k) {
    VecX l = constraints_.rates() * lspeeds[k];
    if (immobile_[static_cast<std::size_t>(k)] == 0) l += constraints_.gradients().transpose() * lW.col(k);
    found.col(k).noalias() = MinvPhi_ * -system_.solve_transposed(l);
  }
  return found;
}

}  // namespace contactvi

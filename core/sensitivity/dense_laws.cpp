#include "sensitivity/dense_laws.hpp"

#include <algorithm>
#include <cmath>

#include "base/tolerances.hpp"

namespace contactvi {

namespace {
// A diagonal below this share of the largest one is rounding: the row moves nothing.
constexpr double kLeastMobility = 1e-12;
constexpr double kSticking = 1e-9;  // of the speeds: a slower slip is that of a contact that sticks
constexpr double kShares = 1e-6;    // of a distribution of impulses without effect: what takes part in it
}  // namespace

void DenseLaws::begin(const DenseStepRecord& step, const VecX& lambda) {
  constraints_ = step.constraints;
  lambda_ = lambda;
  contacts_.clear();
  joints_.clear();
  sign_.clear();
  margin_ = 1.0;
  error_ = 0.0;
}

void DenseLaws::take_law(const DenseStepRecord& step, const VecX& lambda, const VecX& w, const MatX& rows,
                         const VecX& low, const VecX& box, const Scale& scale) {
  begin(step, lambda);
  const double largest = std::max(scale.impulse, kLeastDivisor), speed = std::max(scale.speed, kLeastDivisor);
  const Eigen::Index others = rows.rows() - constraints_;
  const double mobility = others > 0 ? rows.diagonal().tail(others).maxCoeff() : 0.0;
  const auto nearest = [&](double impulse) { margin_ = std::min(margin_, std::abs(impulse) / largest); };
  for (std::size_t k = 0; k < step.joints.size(); ++k) {
    const Eigen::Index r = row_of(k);
    const double g = std::max(rows(r, r), kLeastMobility * mobility), x = lambda[r] - w[r] / g;
    const bool slips = std::abs(x) >= box[r] || box[r] <= 0.0;
    joints_.push_back(slips ? Friction::kSlip : Friction::kStick);
    sign_.push_back(x < 0.0 ? -1.0 : 1.0);
    if (slips) {
      if (box[r] > 0.0) margin_ = std::min(margin_, std::abs(w[r]) / speed);
    } else {
      nearest(box[r] - std::abs(lambda[r]));
      error_ = std::max(error_, std::abs(w[r]) / speed);
    }
  }
  for (const DenseStepRecord::Contact& c : step.contacts) {
    Contact law{Normal::kOpen, Friction::kNone, c.row, c.mu, Eigen::Vector2d::Zero(), 0.0};
    const int r = c.row, count = c.mu > 0.0 ? 3 : 1;
    const double g = std::max(rows.diagonal().segment(r, count).maxCoeff(), kLeastMobility * mobility);
    Eigen::Vector2d xt = Eigen::Vector2d::Zero(), wt = xt;
    if (c.mu > 0.0) {
      wt = w.segment<2>(r + 1);
      xt = lambda.segment<2>(r + 1) - wt / g;
    }
    const double xn = lambda[r] - (w[r] + c.mu * wt.norm()) / g;
    const bool bounded = low[r] > 0.0;
    if (bounded && lambda[r] - w[r] / g <= low[r]) {
      law.normal = Normal::kBound;
      margin_ = std::min(margin_, w[r] / speed);
    } else if (bounded || (c.mu > 0.0 ? c.mu * xt.norm() > -xn : xn > 0.0)) {
      law.normal = Normal::kClosed;
      nearest(lambda[r] - low[r]);
      error_ = std::max(error_, std::abs(w[r]) / speed);
    } else if (lambda[r] > 0.0) {
      error_ = std::max(error_, lambda[r] / largest);
    }
    if (law.normal != Normal::kOpen && c.mu > 0.0) {
      if (xt.norm() <= c.mu * lambda[r] || wt.norm() <= kSticking * speed) {
        law.friction = Friction::kStick;
        error_ = std::max(error_, wt.norm() / speed);
      } else {
        law.friction = Friction::kSlip;
        law.speed = wt.norm();
        law.along = law.speed > 0.0 ? Eigen::Vector2d(wt / law.speed) : Eigen::Vector2d(-xt.normalized());
        margin_ = std::min(margin_, law.speed / speed);
        const Eigen::Vector2d off = lambda.segment<2>(r + 1) + c.mu * lambda[r] * law.along;
        error_ = std::max(error_, off.norm() / largest);
      }
    }
    contacts_.push_back(law);
  }
  set_system(rows);
  // How a load that several points share is distributed is no property of the motion.
  for (const Contact& c : contacts_) {
    if (c.friction != Friction::kStick) continue;
    const double shared = free().cols() > 0 ? free().middleRows(c.row, 3).cwiseAbs().maxCoeff() : 0.0;
    if (shared <= kShares) nearest(std::max(0.0, c.mu * lambda[c.row] - lambda.segment<2>(c.row + 1).norm()));
  }
}

void DenseLaws::take_gaps(const DenseStepRecord& step, const VecX& lambda, const std::vector<double>& gaps,
                          const MatX& rows) {
  begin(step, lambda);
  joints_.assign(step.joints.size(), Friction::kGiven);
  sign_.assign(step.joints.size(), 1.0);
  for (std::size_t i = 0; i < step.contacts.size(); ++i) {
    const DenseStepRecord::Contact& c = step.contacts[i];
    Contact law{Normal::kOpen, Friction::kNone, c.row, c.mu, Eigen::Vector2d::Zero(), 0.0};
    if (lambda[c.row] > 0.0) {
      // A gap that is open: friction holds its normal impulse, unless what that has above friction moves it further.
      // Then the gap is what rounding has left.
      const double held = c.mu > 0.0 ? lambda.segment<2>(c.row + 1).norm() / c.mu : 0.0;
      const double lift = (lambda[c.row] - held) * rows(c.row, c.row) * step.h;
      law.normal = gaps[i] > step.gap_solved && lift < gaps[i] ? Normal::kBound : Normal::kClosed;
    }
    if (law.normal != Normal::kOpen && c.mu > 0.0) law.friction = Friction::kGiven;
    contacts_.push_back(law);
  }
  set_system(rows);
}

// d(s / |s|) / ds.
Eigen::Matrix2d DenseLaws::turn(const Contact& c) const {
  return (Eigen::Matrix2d::Identity() - c.along * c.along.transpose()) / std::max(c.speed, kLeastDivisor);
}

void DenseLaws::set_system(const MatX& rows) {
  MatX A = rows;
  const auto unit = [&](int r, int count) {
    A.middleRows(r, count) = MatX::Identity(rows.rows(), rows.cols()).middleRows(r, count);
  };
  for (std::size_t k = 0; k < joints_.size(); ++k)
    if (joints_[k] != Friction::kStick) unit(static_cast<int>(row_of(k)), 1);
  for (const Contact& c : contacts_) {
    const int r = c.row;
    if (c.normal != Normal::kClosed) unit(r, 1);
    if (c.mu == 0.0) continue;
    if (c.normal == Normal::kOpen || c.friction == Friction::kGiven) unit(r + 1, 2);
    if (c.normal == Normal::kOpen || c.friction != Friction::kSlip) continue;
    A.middleRows(r + 1, 2) = c.mu * lambda_[r] * turn(c) * rows.middleRows(r + 1, 2);
    A.block<2, 2>(r + 1, r + 1) += Eigen::Matrix2d::Identity();
    A.block<2, 1>(r + 1, r) += c.mu * c.along;
  }
  system_.compute(A, constraints_);
}

bool DenseLaws::solve(const VecX& base, const VecX& known, const VecX& mu, const VecX& size, VecX& dlambda) const {
  VecX c = base;
  for (std::size_t k = 0; k < joints_.size(); ++k)
    if (joints_[k] != Friction::kStick) c[row_of(k)] = -sign_[k] * known[row_of(k)];
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    const Contact& law = contacts_[i];
    const int r = law.row;
    if (law.normal == Normal::kOpen) {
      c.segment(r, law.mu > 0.0 ? 3 : 1).setZero();
      continue;
    }
    if (law.normal == Normal::kBound) c[r] = -known[r];
    if (law.friction == Friction::kGiven) c.segment<2>(r + 1) = -known.segment<2>(r + 1);
    if (law.friction != Friction::kSlip) continue;
    const double dmu = mu.size() > 0 ? mu[static_cast<Eigen::Index>(i)] : 0.0;
    c.segment<2>(r + 1) = lambda_[r] * (dmu * law.along + law.mu * turn(law) * base.segment<2>(r + 1));
  }
  return system_.solve(c, size, dlambda);
}

VecX DenseLaws::from_known(const VecX& known) const {
  VecX dlambda;
  solve(VecX::Zero(known.size()), known, VecX(), VecX::Zero(known.size()), dlambda);
  return dlambda;
}

void DenseLaws::solve_transposed(const VecX& l, VecX& lbase, VecX& lknown, VecX& lmu) const {
  const VecX lc = system_.solve_transposed(l);
  lbase = lc;
  lknown.setZero(l.size());
  lmu.setZero(static_cast<Eigen::Index>(contacts_.size()));
  for (std::size_t k = 0; k < joints_.size(); ++k) {
    const Eigen::Index r = row_of(k);
    if (joints_[k] == Friction::kStick) continue;
    lknown[r] = -sign_[k] * lc[r];
    lbase[r] = 0.0;
  }
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    const Contact& law = contacts_[i];
    const int r = law.row;
    if (law.normal == Normal::kOpen) {
      lbase.segment(r, law.mu > 0.0 ? 3 : 1).setZero();
      continue;
    }
    if (law.normal == Normal::kBound) {
      lknown[r] = -lc[r];
      lbase[r] = 0.0;
    }
    if (law.friction == Friction::kGiven) {
      lknown.segment<2>(r + 1) = -lc.segment<2>(r + 1);
      lbase.segment<2>(r + 1).setZero();
    }
    if (law.friction != Friction::kSlip) continue;
    const Eigen::Vector2d lt = lc.segment<2>(r + 1);
    lmu[static_cast<Eigen::Index>(i)] = lambda_[r] * law.along.dot(lt);
    lbase.segment<2>(r + 1) = lambda_[r] * law.mu * turn(law).transpose() * lt;
  }
}

}  // namespace contactvi

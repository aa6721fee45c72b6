#include "cone/slip_speeds.hpp"

#include <Eigen/Cholesky>
#include <algorithm>

#include "base/tolerances.hpp"

namespace contactvi {

namespace {

constexpr double kRegularized = 1e-8;  // of the largest diagonal of the normal equations: old answers may be alike

void read(const BlockSystem& system, const VecX& v, VecX& speeds) {
  speeds.resize(system.contacts());
  for (int c = 0; c < system.contacts(); ++c)
    speeds[c] = has_friction(system.contact(c)) ? system.velocity(c, v).tail<2>().norm() : 0.0;
}

}  // namespace

void SlipSpeeds::clear(const BlockSystem& system) {
  count_ = 0;
  speeds_.assign(system.contacts(), 0.0);
}

void SlipSpeeds::restart(const BlockSystem& system, const VecX& v) {
  count_ = 0;
  read(system, v, now_);
  speeds_.assign(now_.begin(), now_.end());
}

void SlipSpeeds::extrapolate(const BlockSystem& system, const VecX& v) {
  const int m = system.contacts(), keep = kDepth + 1;
  read(system, v, now_);
  if (answers_.rows() != m) {
    answers_.resize(m, keep);
    changes_.resize(m, keep);
    answer_steps_.resize(m, kDepth);
    change_steps_.resize(m, kDepth);
    count_ = 0;
  }
  if (count_ == keep) {
    for (int j = 1; j < keep; ++j) {
      answers_.col(j - 1) = answers_.col(j);
      changes_.col(j - 1) = changes_.col(j);
    }
    --count_;
  }
  answers_.col(count_) = now_;
  changes_.col(count_) = now_ - Eigen::Map<const VecX>(speeds_.data(), m);
  ++count_;
  present_ = now_;
  if (const int q = count_ - 1; q > 0) {
    for (int j = 0; j < q; ++j) {
      answer_steps_.col(j) = answers_.col(j + 1) - answers_.col(j);
      change_steps_.col(j) = changes_.col(j + 1) - changes_.col(j);
    }
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kDepth, kDepth> normal =
        change_steps_.leftCols(q).transpose() * change_steps_.leftCols(q);
    normal.diagonal().array() += kRegularized * normal.diagonal().maxCoeff() + kLeastDivisor;
    Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kDepth, 1> mix =
        change_steps_.leftCols(q).transpose() * changes_.col(q);
    mix = normal.ldlt().solve(mix).eval();
    present_.noalias() -= answer_steps_.leftCols(q) * mix;
    if (!present_.allFinite()) present_ = now_;
  }
  for (int c = 0; c < m; ++c) speeds_[c] = std::max(0.0, present_[c]);
}

}  // namespace contactvi

#include "step/row_system.hpp"

namespace contactvi {

namespace {
// Relative pivot below which rows depend on each other; and above which no such row is looked for, because they do so
// seldom enough for the cheaper factor to be tried first.
constexpr double kRedundant = 1e-10, kIndependent = 1e-7;
}  // namespace

void RowSystem::set(const MatX& matrix, const VecX& row_scale, const VecX& scale) {
  row_scale_ = row_scale;
  scale_ = scale;
  used_.clear();
  for (int k = 0; k < scale.size(); ++k)
    if (scale[k] > 0.0) used_.push_back(k);
  redundant_ = false;
  if (used_.empty()) return;
  matrix_ = row_scale(used_).asDiagonal() * matrix(used_, used_) * scale(used_).asDiagonal();
  lu_.compute(matrix_);
  const auto pivots = lu_.matrixLU().diagonal().cwiseAbs();
  redundant_ = !(pivots.minCoeff() > kIndependent * pivots.maxCoeff());
  if (!redundant_) return;
  factor_.setThreshold(kRedundant);
  factor_.compute(matrix_);
}

void RowSystem::solve(const VecX& residual, const VecX& now, VecX& change) const {
  change.setZero(residual.size());
  if (used_.empty()) return;
  VecX right = -row_scale_.cwiseProduct(residual)(used_);
  if (!redundant_) {
    change(used_) = VecX(lu_.solve(right));
  } else {
    const VecX known = now(used_).cwiseQuotient(scale_(used_));
    right += matrix_ * known;
    change(used_) = VecX(factor_.solve(right) - known);
  }
  change.array() *= scale_.array();
}

}  // namespace contactvi

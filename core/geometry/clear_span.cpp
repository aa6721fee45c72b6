#include "geometry/clear_span.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {
// A reference step is so much longer than the last one: speeds may grow so far before a step counts as more than one.
constexpr double kGrowth = 1.25;
// Of the fastest dof: what is expected of one that is at rest, or the span would end when it starts to move.
constexpr double kLeast = 0.05;
// Stands for one over nothing: a dof that nothing is expected of ends the span when it moves.
constexpr double kHuge = 1e300;
}  // namespace

const VecX& ClearSpan::set_reference(const VecX& bound, double h) {
  const double least = bound.size() > 0 ? kLeast * bound.maxCoeff() : 0.0;
  for (Eigen::Index d = 0; d < bound.size(); ++d) {
    path_[d] = kGrowth * h * std::max(bound[d], least);
    inverse_[d] = path_[d] > 0.0 ? 1.0 / path_[d] : kHuge;
  }
  used_ = allowed_ = 0.0;
  return path_;
}

// Of a reference step with its length, per time.
double ClearSpan::part(const VecX& bound) const {
  double steps = 0.0;
  for (Eigen::Index d = 0; d < bound.size(); ++d) {
    const double part = bound[d] * inverse_[d];
    if (!(part <= steps)) steps = part;  // NaN stays
  }
  return steps;
}

double ClearSpan::part(int n, const double* rate, const double* before) const {
  const double* inverse = inverse_.data();
  double steps = 0.0;
  for (int d = 0; d < n; ++d) {
    const double part = (std::abs(rate[d]) + std::abs(rate[d] - before[d])) * inverse[d];
    if (!(part <= steps)) steps = part;  // NaN stays
  }
  return steps;
}

bool ClearSpan::take(const VecX& bound, double h) { return allowed_ > 0.0 && enter(part(bound) * h); }

bool ClearSpan::take(int n, const double* rate, const double* before, double h) {
  return allowed_ > 0.0 && enter(part(n, rate, before) * h);
}

// A step that counts as so many reference steps.
bool ClearSpan::enter(double steps) {
  if (!(used_ + 2.0 * steps < allowed_)) return false;
  last_ = steps;
  used_ += steps;
  return true;
}

bool ClearSpan::enter_foreseen(double steps) {
  const double used = foreseen_.empty() ? used_ : foreseen_.back().used;
  if (!(allowed_ > 0.0 && used + 2.0 * steps < allowed_)) return false;
  foreseen_.push_back({steps, used + steps});
  return true;
}

}  // namespace contactvi

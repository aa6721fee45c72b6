#include "step/impulse_step.hpp"

#include <cmath>

namespace contactvi {

void ImpulseStep::begin(const VecCRef& q0, double h, const VecX& tau, const VecCRef& v) {
  StepEquations::begin(q0, p0_, h, tau);
  part_ = true;
  clear_turns();
  start_constant(v);
}

double ImpulseStep::iterate(const VecCRef& p, bool factor, bool first) {
  p0_ = p;
  stages_.start_from(p);
  iterate_stages((factor ? kLaneFactor : 0) | (first ? kLaneFirst : 0));
  double largest = 0.0;
  for (int d = 0; d < tree_->nv; ++d) {
    const double dv = std::abs(stages_.dv()[static_cast<std::size_t>(d) * stages_.padded()]);
    if (!(dv <= largest)) largest = dv;
    if (std::isnan(dv)) return dv;
  }
  return std::isfinite(largest) ? largest : std::nan("");
}

void ImpulseStep::solve_step_matrix(Eigen::Ref<MatX> X) {
  columns_.solve(stages_, X);
  if (stiff_.any()) stiff_.correct(X);
}

void ImpulseStep::add_velocity(const VecCRef& dv) {
  const int S = stages_.padded();
  for (int d = 0; d < tree_->nv; ++d)
    for (int i = 0; i < S; ++i) stages_.v()[d * S + i] += dv[d];
}

void ImpulseStep::stage_velocity(VecRef v) const {
  for (int d = 0; d < tree_->nv; ++d) v[d] = stages_.v()[static_cast<std::size_t>(d) * stages_.padded()];
}

}  // namespace contactvi

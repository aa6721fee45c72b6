// Integrator: the midpoint step with a start momentum that is found while the step is solved (present_dt.cpp).
#include <algorithm>
#include <cmath>

#include "step/integrator.hpp"

namespace contactvi {

void Integrator::begin_with_impulse(const VecCRef& q0, double h, const VecX& tau, const VecCRef& v) {
  begin(q0, p0_, h, tau);
  part_ = true;
  solved_ = false;
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical) continue;
    double* X = stages_.X() + static_cast<std::size_t>(joint.iv) * stages_.padded();
    std::fill(X, X + 3 * stages_.padded(), 0.0);
  }
  start_constant(v);
}

double Integrator::iterate_with_impulse(const VecCRef& p, bool factor, bool first) {
  p0_ = p;
  stages_.start_from(p);
  stages_.sweep((factor ? kLaneFactor : 0) | (first ? kLaneFirst : 0));
  if (stiff_.any()) {
    if (factor) stiff_.factor(stages_, q0_);
    stiff_.correct(stages_);
  }
  ++counters.stage_iterations;
  counters.factorizations += factor;
  double largest = 0.0;
  for (int d = 0; d < tree_->nv; ++d) {
    const double dv = std::abs(stages_.dv()[static_cast<std::size_t>(d) * stages_.padded()]);
    if (!(dv <= largest)) largest = dv;
    if (std::isnan(dv)) return dv;
  }
  return std::isfinite(largest) ? largest : std::nan("");
}

// One column per lane: the factor of a single stage lies in all of them.
void Integrator::solve_columns(Stages& stages, Eigen::Ref<MatX> X) {
  const int S = stages.padded(), count = static_cast<int>(X.cols());
  for (int first = 0; first < count; first += S) {
    for (int d = 0; d < tree_->nv; ++d)
      for (int i = 0; i < S; ++i) stages.dv()[d * S + i] = X(d, std::min(first + i, count - 1));
    stages.solve();
    for (int d = 0; d < tree_->nv; ++d)
      for (int i = 0; i < S && first + i < count; ++i) X(d, first + i) = stages.dv()[d * S + i];
  }
}

void Integrator::solve_with_impulse(Eigen::Ref<MatX> X) {
  solve_columns(stages_, X);
  if (stiff_.any()) stiff_.correct(X);
}

void Integrator::solve_masses(Eigen::Ref<MatX> X) { solve_columns(node_, X); }

void Integrator::place_node(const VecCRef& q) {
  node_.at(q);
  node_.place();
  node_.factor();
}

void Integrator::add_velocity(const VecCRef& dv) {
  const int S = stages_.padded();
  for (int d = 0; d < tree_->nv; ++d)
    for (int i = 0; i < S; ++i) stages_.v()[d * S + i] += dv[d];
}

void Integrator::stage_velocity(VecRef v) const {
  for (int d = 0; d < tree_->nv; ++d) v[d] = stages_.v()[static_cast<std::size_t>(d) * stages_.padded()];
}

}  // namespace contactvi

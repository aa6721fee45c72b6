// What the implicit impact maps (DTEC, MHC) share: one scalar equation in the impulse, E(lambda) + lambda offset =
// target, where E depends on lambda through the velocities of the rest of the step from p+ = p- + lambda W^T. It is
// solved by the secant method from CTEC's lambda, with dE/dlambda ~ gamma+ to start. Where that has no admissible root
// the impulse falls back to CTEC's, and the result gives the reason.
#pragma once

#include "impact/impact_law.hpp"

namespace contactvi {

class ScalarMap : public ImpactLaw {
 public:
  bool implicit() const final { return true; }
  ImpactResult apply(const ImpactProblem& problem, VecRef p) const final;
  ImpactResult correct(const ImpactProblem& problem, const ImpactResult& start, VecRef p) const final;

 protected:
  ~ScalarMap() = default;
  // The map's scalar after the impact, from the rest of the step from p_plus; NaN where that could not be solved.
  virtual double scalar(const ImpactProblem& problem, const VecX& p_plus) const = 0;

 private:
  double balance(const ImpactProblem& problem, const VecX& p_plus, double impulse) const;
};

}  // namespace contactvi

#include "impact/dtec.hpp"

#include <limits>

#include "impact/ctec.hpp"

namespace contactvi {

namespace {

double energy_after(const ImpactProblem& problem, const VecX& p_plus) {
  Integrator& integrator = problem.integrator;
  if (!integrator.solve_closely(problem.q, p_plus, problem.remainder, problem.tau))
    return std::numeric_limits<double>::quiet_NaN();
  // E_d is a mean over the rest of the step: what damping and inputs do until there is not the impact's.
  return integrator.discrete_energy() - integrator.mean_work();
}

}  // namespace

ImpactResult impact_dtec(const ImpactProblem& problem, VecRef p) {
  const ImpactResult ctec = impact_ctec(problem, p);
  return ctec.ok ? impact_dtec(problem, ctec, p) : ctec;
}

ImpactResult impact_dtec(const ImpactProblem& problem, const ImpactResult& ctec, VecRef p) {
  return solve_impact(problem, ctec, &energy_after, p);
}

}  // namespace contactvi

#include "impact_dtec.hpp"

#include <limits>

#include "impact_ctec.hpp"

namespace contactvi {

double discrete_energy(Integrator& integrator) {
  StepWorkspace& ws = integrator.workspace();
  world_placements(integrator.tree(), ws.kernel);
  VecX unused = VecX::Zero(integrator.tree().nv);
  return 0.5 * ws.P.dot(integrator.v()) + gravity_potential(integrator.tree(), ws.kernel) +
         add_springs(integrator.tree(), ws.q_mid, unused);
}

namespace {

double energy_after(const ImpactProblem& problem, const VecX& p_plus) {
  VecX guess = p_plus;
  problem.integrator.mass().solve(guess);
  if (!problem.integrator.solve(problem.q, p_plus, guess, problem.remainder, problem.tau))
    return std::numeric_limits<double>::quiet_NaN();
  return discrete_energy(problem.integrator);
}

}  // namespace

ImpactResult impact_dtec(const ImpactProblem& problem, VecRef p) {
  const ImpactResult ctec = impact_ctec(problem, p);
  return ctec.ok ? solve_impact(problem, ctec, &energy_after, p) : ctec;
}

}  // namespace contactvi

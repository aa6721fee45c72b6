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
  // E_d belongs to the middle of the rest: what damping and inputs do until there is not the impact's.
  Integrator& integrator = problem.integrator;
  const double power = nonconservative_power(integrator.tree(), integrator.v(), problem.tau, integrator.workspace());
  return discrete_energy(integrator) - 0.5 * problem.remainder * power;
}

}  // namespace

ImpactResult impact_dtec(const ImpactProblem& problem, VecRef p) {
  const ImpactResult ctec = impact_ctec(problem, p);
  return ctec.ok ? solve_impact(problem, ctec, &energy_after, p) : ctec;
}

}  // namespace contactvi

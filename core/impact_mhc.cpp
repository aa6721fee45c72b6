#include "impact_mhc.hpp"

#include <limits>

#include "energy.hpp"
#include "impact_ctec.hpp"

namespace contactvi {

namespace {

double modified_energy_at_end(const ImpactProblem& problem, const VecX& p_plus) {
  Integrator& integrator = problem.integrator;
  VecX guess(p_plus.size()), q1(problem.q.size()), p1(p_plus.size());
  if (!integrator.node_velocity(problem.q, p_plus, guess) ||
      !integrator.solve(problem.q, p_plus, guess, problem.remainder, problem.tau))
    return std::numeric_limits<double>::quiet_NaN();
  integrate(integrator.tree(), problem.q, integrator.v(), problem.remainder, q1);
  end_momentum(integrator.tree(), p_plus, integrator.v(), problem.remainder, integrator.workspace(), p1);
  const double power = nonconservative_power(integrator.tree(), integrator.v(), problem.tau, integrator.workspace());
  return modified_hamiltonian(integrator, q1, p1, problem.dt) - problem.remainder * power;
}

}  // namespace

ImpactResult impact_mhc(const ImpactProblem& problem, VecRef p) {
  const ImpactResult ctec = impact_ctec(problem, p);
  return ctec.ok ? solve_impact(problem, ctec, &modified_energy_at_end, p) : ctec;
}

}  // namespace contactvi

#include "impact/mhc.hpp"

#include <limits>

#include "impact/ctec.hpp"
#include "step/energy.hpp"

namespace contactvi {

namespace {

double modified_energy_at_end(const ImpactProblem& problem, const VecX& p_plus) {
  Integrator& integrator = problem.integrator;
  if (!integrator.solve_closely(problem.q, p_plus, problem.remainder, problem.tau))
    return std::numeric_limits<double>::quiet_NaN();
  VecX q1(problem.q.size()), p1(p_plus.size());
  integrator.finish(q1, p1);
  const double work = integrator.work();
  return modified_hamiltonian(integrator, q1, p1, problem.dt) - work;
}

}  // namespace

ImpactResult impact_mhc(const ImpactProblem& problem, VecRef p) {
  const ImpactResult ctec = impact_ctec(problem, p);
  return ctec.ok ? impact_mhc(problem, ctec, p) : ctec;
}

ImpactResult impact_mhc(const ImpactProblem& problem, const ImpactResult& ctec, VecRef p) {
  return solve_impact(problem, ctec, &modified_energy_at_end, p);
}

}  // namespace contactvi

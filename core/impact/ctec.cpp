#include "impact/ctec.hpp"

#include <cmath>

namespace contactvi {

ImpactResult impact_ctec(const ImpactProblem& problem, VecRef p) {
  ImpactResult result;
  if (!(problem.G_c > 0.0)) return result;  // nothing that could move: no impulse is finite
  // The quadratic H(p- + lambda W) - H(p-) = lambda gamma- + lambda^2 G_c/2 = -loss has this root away from lambda =
  // 0.
  result.impulse = -(1.0 + problem.restitution) * problem.gamma_minus / problem.G_c;
  result.ok = std::isfinite(result.impulse);
  if (result.ok) p = problem.p_minus + result.impulse * problem.W;
  return result;
}

}  // namespace contactvi

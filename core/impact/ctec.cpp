#include "impact/ctec.hpp"

#include <cmath>

namespace contactvi {

namespace {

class Ctec final : public ImpactLaw {
 public:
  const char* name() const override { return "ctec"; }
  bool implicit() const override { return false; }
  bool allows_persistent_contact() const override { return true; }
  ImpactResult apply(const ImpactProblem& problem, VecRef p) const override { return explicit_impulse(problem, p); }
  ImpactResult correct(const ImpactProblem&, const ImpactResult& start, VecRef) const override { return start; }
};

}  // namespace

const ImpactLaw& ctec_law() {
  static const Ctec law;
  return law;
}

ImpactResult explicit_impulse(const ImpactProblem& problem, VecRef p) {
  ImpactResult result;
  if (!(problem.G_c > 0.0)) return result;  // nothing can move: no impulse is finite
  // The quadratic H(p- + lambda W) - H(p-) = lambda gamma- + lambda^2 G_c/2 = -loss has this root away from lambda =
  // 0.
  result.impulse = -(1.0 + problem.restitution) * problem.gamma_minus / problem.G_c;
  result.ok = std::isfinite(result.impulse);
  if (result.ok) p = problem.p_minus + result.impulse * problem.W;
  return result;
}

}  // namespace contactvi

#include "impact/dtec.hpp"

#include <limits>

#include "impact/scalar_map.hpp"

namespace contactvi {

namespace {

class Dtec final : public ScalarMap {
 public:
  const char* name() const override { return "dtec"; }
  bool allows_persistent_contact() const override { return false; }

  void evaluate_before(const FreeState& now, double partial, long, ImpactReference& reference) const override {
    if (partial > 0.0) {
      const double work = now.stepper.work();
      reference.value = now.stepper.discrete_energy() + work - now.stepper.mean_work();
      return;
    }
    reference.value = now.stepper.modified_hamiltonian(now.t, now.q, now.p, 0.0);  // H
  }

 protected:
  double scalar(const ImpactProblem& problem, const VecX& p_plus) const override {
    Stepper& rest = problem.rest;
    if (!rest.solve_closely(problem.q, p_plus, problem.remainder, problem.tau))
      return std::numeric_limits<double>::quiet_NaN();
    // E_d is a mean over the rest of the step: what damping and inputs do until there is not the impact's.
    return rest.discrete_energy() - rest.mean_work();
  }
};

}  // namespace

const ImpactLaw& dtec_law() {
  static const Dtec law;
  return law;
}

}  // namespace contactvi

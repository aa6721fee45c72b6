#include "impact/dtec.hpp"

#include <limits>

#include "impact/scalar_map.hpp"
#include "step/energy.hpp"

namespace contactvi {

namespace {

class Dtec final : public ScalarMap {
 public:
  const char* name() const override { return "dtec"; }
  bool allows_persistent_contact() const override { return false; }

  void evaluate_before(const FreeState& now, double partial, long, ImpactReference& reference) const override {
    if (partial > 0.0) {
      const double work = now.integrator.work();
      reference.value = now.integrator.discrete_energy() + work - now.integrator.mean_work();
      return;
    }
    const Energy at_node = energy(now.integrator, now.q, now.p);
    reference.value = at_node.kinetic + at_node.potential;
  }

 protected:
  double scalar(const ImpactProblem& problem, const VecX& p_plus) const override {
    Integrator& integrator = problem.integrator;
    if (!integrator.solve_closely(problem.q, p_plus, problem.remainder, problem.tau))
      return std::numeric_limits<double>::quiet_NaN();
    // E_d is a mean over the rest of the step: what damping and inputs do until there is not the impact's.
    return integrator.discrete_energy() - integrator.mean_work();
  }
};

}  // namespace

const ImpactLaw& dtec_law() {
  static const Dtec law;
  return law;
}

}  // namespace contactvi

#include "impact/mhc.hpp"

#include <limits>

#include "impact/scalar_map.hpp"

namespace contactvi {

namespace {

class Mhc final : public ScalarMap {
 public:
  const char* name() const override { return "mhc"; }
  bool allows_persistent_contact() const override { return true; }

  void start_run(const FreeState& start, ImpactReference& reference) const override {
    reference.value = start.stepper.modified_hamiltonian(start.t, start.q, start.p, start.dt);
  }

  void start_step(const FreeState& start, ImpactReference& reference) const override {
    if (reference.kind == MhcReference::kRun) return;
    reference.q = start.q;
    reference.p = start.p;
    reference.t = start.t;
    reference.step = -1;
  }

  // A reference carried through the run is that of its free motion: it begins anew where persistent contact ends.
  void resume(const FreeState& now, ImpactReference& reference) const override {
    start_step(now, reference);
    if (reference.kind == MhcReference::kRun) start_run(now, reference);
  }

  void evaluate_before(const FreeState& now, double partial, long step, ImpactReference& reference) const override {
    const double work = partial > 0.0 ? now.stepper.work() : 0.0;
    if (reference.kind == MhcReference::kStep && reference.step != step) {
      reference.step = step;
      reference.value = now.stepper.modified_hamiltonian(reference.t, reference.q, reference.p, now.dt);
    }
    reference.value += work;
  }

 protected:
  double scalar(const ImpactProblem& problem, const VecX& p_plus) const override {
    Stepper& rest = problem.rest;
    if (!rest.solve_closely(problem.q, p_plus, problem.remainder, problem.tau))
      return std::numeric_limits<double>::quiet_NaN();
    VecX q1(problem.q.size()), p1(p_plus.size());
    rest.finish(q1, p1);
    const double work = rest.work();
    return rest.modified_hamiltonian(problem.time + problem.remainder, q1, p1, problem.dt) - work;
  }
};

}  // namespace

const ImpactLaw& mhc_law() {
  static const Mhc law;
  return law;
}

}  // namespace contactvi

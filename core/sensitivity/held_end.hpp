// The end of a held step, as a function of the state before its last impulse: the velocity there, the impulse and the
// numbers of slips (held_node.hpp) that leave the rows and what is across the slips no speed, and the slips that come
// to rest.
#pragma once

#include "sensitivity/end_force.hpp"
#include "sensitivity/held_node.hpp"
#include "sensitivity/shared_load.hpp"
#include "step/step_tangent.hpp"

namespace contactvi {

class HeldEnd {
 public:
  explicit HeldEnd(const Scene& scene);

  // Takes a step whose last node this is; both are to stay alive. fixed: rows of the constraints; momenta: has M.
  void take(HeldNode& node, const HeldStepRecord& step, const PersistentRows& phase, int fixed, StepTangent& momenta);
  // (q1, p1), and the slips that come to rest, the first of which ended the step.
  Eigen::Index size() const { return 2 * nv_ + rest_speeds_.cols(); }
  Eigen::Index rests() const { return rest_speeds_.cols(); }
  // end: changes of (q1, p1), before the impulse and after it, and of these slips, (size,); heavier: of M v by the
  // masses, later: of the time. The velocity changes by dv, which is left out where nothing slides. False where the
  // impulse does not exist; sizes: of the terms of its equations.
  bool add_impulse(const VecX& heavier, double later, const VecX& sizes, VecRef end, VecX& dv);
  // The transpose: from the gradients in the end, (size,), and in the velocity to those in (q1, p1) before the impulse
  // and in M v.
  void pass(const VecX& lend, VecX lv, VecX& lq, VecX& lp, VecX& lheavier);
  // Of the terms of the speeds that are zero, and of the slips that come to rest, along a direction in which q and p
  // change by so much; h: length of the step.
  VecX speed_sizes(double q, double p, double h) const { return sizes(watched(), MinvC_, q / h, p); }
  VecX rest_sizes(double q, double p, double h) const {
    return sizes(rest_speeds_, MinvR_, q / h, p) + q * rest_changes_.cwiseAbs().rowwise().sum();
  }
  // Of a step that a force ends; number: of the node among the places of phase.
  PhaseEnd phase_end(const PersistentRows& phase, int number);

 private:
  void take_rests(const PersistentRows& phase);
  const MatX& watched() const { return node_->watched(); }
  static VecX sizes(const MatX& C, const MatX& MinvC, double q, double p) {
    return (q * C.cwiseAbs() + p * MinvC.cwiseAbs()).colwise().sum().transpose();
  }

  int nv_, fixed_ = 0;
  Integrator masses_;
  const HeldNode* node_ = nullptr;
  const HeldStepRecord* record_ = nullptr;
  // d(M v)/dq, changes of the speeds, M^-1 of what is given and of what is watched, the equations of the impulse and
  // the numbers.
  MatX mass_change_, watched_change_, along_change_, MinvF_, MinvC_;
  SharedLoad system_;
  std::vector<int> undirected_;  // directions that nothing determines
  // Of the slips that come to rest: gradients by the velocity, (nv, count), with M^-1 of these, and by the
  // configuration, (count, nv).
  MatX rest_speeds_, MinvR_, rest_changes_;
  VecX rest_rates_;  // by the time
};

}  // namespace contactvi

// What has been done on a scene since the reset: work of inputs, losses by damping and friction, and the reactions of
// constraints. A value: part of the state of a run.
#pragma once

#include "contact/contact_step.hpp"
#include "contact/dense_step.hpp"
#include "impact/sequence.hpp"
#include "record/recording.hpp"
#include "step/integrator.hpp"

namespace contactvi {

// What has been done so far.
struct WorkTally {
  bool does_work = false;  // whether anything but gravity and springs does work; else nothing is counted
  // Work [J] of inputs, servos and wrenches; dissipated by damping, by joint friction; of driven constraints.
  double input = 0, damping = 0, joint_friction = 0, driven = 0;
  // Impulses of the constraints since the last node, then those of all that acts on coupled joints that follow but for
  // the reaction of the coupling and for inertia; their mean force before it.
  VecX reactions, mean_reactions;
  double node_time = 0;  // [s]
  VecX pending;          // what the momenta of followers had at the last node, and count then as part of the next sum
};

class WorkAccount {
 public:
  // does_work: as of WorkTally.
  // p: the momentum at the start.
  void start(double t, const Tree& tree, const VecX& p, bool does_work);
  // Inputs do work from now on.
  void expect_inputs() { tally_.does_work = true; }

  // Works of one smooth step [J], taken before the integrator solves another one.
  struct FreeWork {
    double input = 0, damping = 0, driven = 0, joint_friction = 0;
    VecX reactions = {};  // as of WorkTally; empty: none
  };
  FreeWork of(const Integrator& integrator) const;
  void add(const FreeWork& work);
  // Of a part of the scene; rows: its reactions in this account's numbers.
  void add(const FreeWork& work, const std::vector<int>& rows);
  void add(const ContactStep& step);
  void add(const DenseStep& step);
  void add(const ImpactSequence& impacts);
  // Adds what another account has counted since it was last taken; rows: its reactions in this one's numbers.
  void take(WorkAccount& part, const std::vector<int>& rows);
  void clear();
  // Appends the entries of the node at t [s] that was recorded last.
  void record_node(double t, const Tree& tree, Recording& recording);

  const WorkTally& tally() const { return tally_; }
  void recall(const WorkTally& tally) { tally_ = tally; }

 private:
  void add_reactions(const VecX& impulses);

  WorkTally tally_;
};

}  // namespace contactvi

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
  VecX reactions, mean_reactions;  // impulses of the constraints since the last node; their mean force before it
  double node_time = 0;            // [s]
};

class WorkAccount {
 public:
  // does_work: as of WorkTally.
  void start(double t, int constraint_rows, bool does_work);
  // Inputs do work from now on.
  void expect_inputs() { tally_.does_work = true; }

  // Works of one smooth step [J], taken before the integrator solves another one.
  struct FreeWork {
    double input = 0, damping = 0, driven = 0;
  };
  FreeWork of(const Integrator& integrator);
  void add(const FreeWork& work);
  void add(const ContactStep& step);
  void add(const DenseStep& step);
  void add(const ImpactSequence& impacts);
  // Adds what another account has counted since it was last taken; rows: its constraint rows in this one's numbers.
  void take(WorkAccount& part, const std::vector<int>& rows);
  void clear();
  // Appends the entries of the node at t [s] that was recorded last.
  void record_node(double t, Recording& recording);

  const WorkTally& tally() const { return tally_; }
  void recall(const WorkTally& tally) { tally_ = tally; }

 private:
  WorkTally tally_;
  VecX seen_;  // impulses of the constraints in the step that of() was last asked for; empty: none
};

}  // namespace contactvi

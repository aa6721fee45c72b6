// Several steps of several runs, one step after the other, in the lanes of the kernel: with start values, stage
// iterations and ends, as each run would make them alone.
//
// Trees of revolute, helical and prismatic joints and translations, whose numbers in q are added to those in v. A run
// whose step asks for more than the first factor ends there: it makes that step by itself.
#pragma once

#include <vector>

#include "step/integrator.hpp"
#include "step/stage_lanes.hpp"

namespace contactvi {

class LaneFlight {
 public:
  LaneFlight(const FlatModel& model, StageLanes& lanes);

  // Solves steps of runs of one kind, each from its own state on, and leaves them with the runs; returns how many stage
  // iterations that took, each counted once for every run in it.
  long fly(const std::vector<Integrator*>& runs);

 private:
  void board(const std::vector<Integrator*>& runs);
  void start_values(int step);
  long iterate(const std::vector<Integrator*>& runs, int step);
  void keep(int step, int lane);
  void keep_all(int step);
  void finish(int step);
  void set_base(const std::vector<Integrator*>& runs);
  void leave(const std::vector<Integrator*>& runs, int step);
  double* at(int step, StepsAhead::Part part) {
    return steps_.data() + static_cast<std::size_t>(step * StepsAhead::kParts + part) * size_;
  }

  StageLanes* lanes_;
  int nv_, width_, size_;     // size_ = nv_ width_
  std::vector<double> turn_;  // of the joint's frame, which is part of the base, [dof][lane]
  std::vector<char> winds_;   // whether whole revolutions are taken off its angle
  AlignedArray steps_;        // the parts of each step, [dof][lane]
  AlignedArray history_;      // velocities of the steps before, oldest first
  AlignedArray weight_, q_, carry_q_, carry_p_;
  std::vector<char> flies_;          // by lane: its steps are solved so far
  std::vector<char> pending_;        // by lane: this step is not
  std::vector<int> done_;            // lanes whose step was done in the last iteration
  std::vector<int> iterations_;      // by lane, of this step
  std::vector<const double*> past_;  // velocities of this step's predecessors, newest first
};

}  // namespace contactvi

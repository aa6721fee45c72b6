// Several steps of several runs, one step after the other, in the lanes of the kernel: with start values, stage
// iterations and ends, as each run would make them alone.
//
// Trees of revolute, helical, prismatic and spherical joints and translations. A run whose step asks for more than the
// first factor ends there: it makes that step by itself.
#pragma once

#include <vector>

#include "step/integrator.hpp"
#include "step/stage_lanes.hpp"

namespace contactvi {

class LaneFlight {
 public:
  LaneFlight(const Tree& tree, const FlatModel& model, StageLanes& lanes);

  // Solves steps of runs of one kind, each from its own state on, and leaves them with the runs; returns how many stage
  // iterations that took, each counted once for every run in it.
  long fly(const std::vector<Integrator*>& runs);

 private:
  // Dofs whose numbers in v are added to those in q, which follow each other in both; a joint with a quaternion.
  struct Plain {
    int q, v, count;
  };
  struct Ball {
    int q, v, base;
    const double* C;
  };
  void find_dofs(const Tree& tree, const FlatModel& model);
  void board(const std::vector<Integrator*>& runs);
  void start_values(int step);
  void start_stages(int step);
  long iterate();
  void measure();
  void copy_stages(int lane, bool aside);
  void stop_far_turns(int step);
  void finish(int step);
  void finish_balls(int step);
  void finish_followers(int step);
  void set_base();
  void leave(const std::vector<Integrator*>& runs, int step);
  double* at(int step, StepsAhead::Part part) {
    return steps_.data() + static_cast<std::size_t>(step * StepsAhead::kParts + part) * size_;
  }
  double* weight(int m) { return weight_.data() + m * width_; }
  bool none_flies() const;

  static constexpr int kArrays = 7;  // of the stages of a step; the last two on trees with balls alone

  StageLanes* lanes_;
  int nq_, nv_, width_, count_ = 0;  // count_: of runs
  int size_;                         // of a part of a step, nq width
  std::vector<Plain> plain_;
  std::vector<Ball> balls_;
  std::vector<double> turn_;  // of the joint's frame, which is part of the base, [dof][lane]
  std::vector<char> winds_;   // whether whole revolutions are taken off its angle
  AlignedArray steps_;        // the parts of each step, [number][lane]
  AlignedArray turned_;       // of the step under way: Y of the stages
  AlignedArray early_;        // arrays of the stages of lanes that are done before others
  AlignedArray history_;      // velocities of the steps before, oldest first
  AlignedArray weight_;       // of the steps before in start values, and h b, [number][lane]
  AlignedArray q_, carry_q_, carry_p_;
  LaneWork work_;                      // of the step under way
  AlignedArray error_, energy_;        // by lane, after an iteration
  AlignedArray spare_;                 // a step of no run
  std::vector<double*> rows_;          // by lane: where the step goes
  std::vector<StageIteration> judge_;  // by lane
  std::vector<char> flies_;            // by lane: its steps are solved so far
  std::vector<char> pending_;          // by lane: this step is not
  std::vector<int> done_;              // lanes whose step was done in the last iteration
  std::vector<int> early_lanes_;       // lanes that were done in an earlier one
  std::vector<int> iterations_;        // by lane, of this step
  std::vector<Follower> followers_;    // of the tree
};

}  // namespace contactvi

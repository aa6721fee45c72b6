// Steps with one stage of several runs side by side in the lanes of the kernel: copies of their arrays, lane by lane.
//
// All runs have the same flat model. What else the kernel asks of a step is a number in its lane.
#pragma once

#include <vector>

#include "step/stages.hpp"

namespace contactvi {

class StageLanes {
 public:
  explicit StageLanes(const FlatModel& model);
  StageLanes(const StageLanes&) = delete;
  StageLanes& operator=(const StageLanes&) = delete;

  // Lanes of the instruction set in use.
  static int most_runs() { return run_kernel().lanes; }
  // Whether a run's steps can take a lane.
  bool fits(const FlatModel& model) const;
  // Steps that take lanes together have the same kinds of forces: that of the step that began.
  static int kind(const Stages& step);

  // The steps that take lanes, of one kind and at most most_runs(), as they are before an iteration.
  void seat(const std::vector<Stages*>& steps);
  // One iteration of all that have a lane.
  void iterate(int flags);
  // What the last iteration left in a step per stage.
  void fetch_numbers(int lane);
  // Ends the iterations of the step in a lane: its arrays are those that it would have alone, but for the factor.
  void fetch(int lane);
  // dv <- (M + diagonal)^-1 dv at X of so many steps, at most most_runs().
  void solve_masses(const std::vector<Stages*>& steps);
  // For a change of the velocities between two iterations.
  void fetch_correction(int lane);
  void put_velocity(int lane);

 private:
  friend class LaneFlight;  // makes several steps in them
  void assign(const std::vector<Stages*>& steps);
  static void add_extra(void* self);
  void add_forces();
  void put(const double* from, double* to, int count, int lane) const;
  void get(const double* from, double* to, int count, int lane) const;
  void spread(double* Stages::* from, double* to, int count) const;

  std::vector<LaneJoint> joints_;
  std::vector<LaneFollower> followers_;
  std::vector<LaneLeader> leaders_;
  std::vector<LaneCoupling> couplings_;
  std::vector<LaneTerm> terms_;
  std::vector<int> path_;
  LaneTree tree_;
  const RunKernel* kernel_;
  LaneWork work_;
  AlignedArray memory_;
  double *X_, *v_, *rate_, *P_, *G_, *Y_, *px_, *dv_, *magnitude_, *diagonal_;
  double *base_, *ball_base_, *p0_, *stiffness_, *deflection_, *damping_, *tau_, *per_stage_, *tableau_;
  std::vector<Stages*> steps_;     // by lane, null: it has been fetched
  std::vector<Stages*> boarding_;  // those that are about to take lanes
};

}  // namespace contactvi

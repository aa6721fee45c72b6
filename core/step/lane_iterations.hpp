// The iterations of steps of several runs in the lanes of the kernel.
#pragma once

#include <vector>

#include <memory>
#include "step/lane_flight.hpp"
#include "step/stage_lanes.hpp"

namespace contactvi {

class LaneIterations {
 public:
  explicit LaneIterations(const Integrator& step) : lanes_(step.model_) {}

  bool fits(const Integrator& step) const { return lanes_.fits(step.model_); }
  // Iterates steps that have begun, each as far as it goes alone: every decision is one of the step itself. Those that
  // go on afterwards share their iterations with none of the others. Those that ask for steps in advance get them.
  void iterate(std::vector<Integrator*>& steps);
  // Iterations so far, each counted once for every step in it.
  long made() const { return made_; }

 private:
  struct Key {
    int flags, kind;
    bool ahead;  // it asks for steps in advance
    bool operator==(const Key& other) const {
      return flags == other.flags && kind == other.kind && ahead == other.ahead;
    }
  };
  static Key key(const Integrator& step);
  void seat(std::vector<Integrator*>& steps);
  void iterate_seated(std::vector<Integrator*>& steps);
  bool judge(int lane);

  StageLanes lanes_;
  std::unique_ptr<LaneFlight> flight_;  // made when it is first used
  long made_ = 0;
  std::vector<Integrator*> seated_;  // by lane, null: its step iterates no more with the factor that it has
  std::vector<Stages*> stages_;
};

}  // namespace contactvi

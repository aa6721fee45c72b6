// What a world saves, as values.
#pragma once

#include <memory>
#include <vector>

#include "run/island.hpp"

namespace contactvi {

// All that the rest of a run depends on.
struct SavedWorld {
  std::shared_ptr<const Snapshot> whole;
  bool divided = false;
  RunState run;
  std::vector<LooseState> loose;
  std::vector<JointFriction> joint_friction;
  std::vector<double> motion;
  MatX straight;
  VecX tau, q_ref, v_ref;
  EngineCounters counters;
  struct SavedIsland {
    std::vector<int> trees;
    std::shared_ptr<const Snapshot> engine;
    Rest rest;
    Recording record;  // of the step that an island at rest repeats
    VecX mean_reactions, tau;
    MatX target;
    std::vector<double> turns;
  };
  std::vector<SavedIsland> islands;
};

}  // namespace contactvi

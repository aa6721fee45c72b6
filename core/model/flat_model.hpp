// The tree in the form of the stage kernel: flat, with body frames turned about their joint axes so that the transforms
// between them are rotations in planes.
#pragma once

#include <vector>

#include "lanes/lanes.hpp"
#include "model/tree.hpp"

namespace contactvi {

struct FlatModel {
  explicit FlatModel(const Tree& tree);
  FlatModel(const FlatModel&) = delete;
  FlatModel& operator=(const FlatModel&) = delete;

  std::vector<LaneJoint> joints;  // in the tree's order
  // Coupled joints; the terms of followers, then those of leaders.
  std::vector<LaneFollower> followers;
  std::vector<LaneLeader> leaders;
  std::vector<LaneCoupling> couplings;
  std::vector<LaneTerm> terms;
  std::vector<int> path;  // the joints and dofs of each follower
  LaneTree lanes;         // points at all of these

 private:
  void take_couplings(const Tree& tree);
};

// Names of the builds of the kernel that this processor can run, best last: "base", "avx2", "avx512".
std::vector<const char*> instruction_sets();
// The build that engines made from now on use: at first the best one, or that of the environment variable
// CONTACTVI_INSTRUCTION_SET, where a wrong name is a Refusal. The digits do not depend on it.
const char* instruction_set();
bool set_instruction_set(const char* name);  // false: unknown, or not of this processor
const LaneKernel& lane_kernel(int stages);
const RunKernel& run_kernel();

}  // namespace contactvi

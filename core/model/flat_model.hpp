// The tree as the stage kernel wants it: flat, with body frames turned about their joint axes so that the transforms
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
  LaneTree lanes;                 // points at joints
};

// Which build of the kernel engines made from now on use: "base", "avx2", "avx512". At first the best that this
// processor has, or what the environment variable CONTACTVI_INSTRUCTION_SET says. The digits do not depend on it.
std::vector<const char*> instruction_sets();  // that this processor has, best last
const char* instruction_set();
bool set_instruction_set(const char* name);  // false: unknown, or not of this processor
const LaneKernel& lane_kernel(int stages);

}  // namespace contactvi

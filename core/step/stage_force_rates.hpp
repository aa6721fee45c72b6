// How the forces at the stages of a solved step change with time, at the displacements and velocities that they have.
#pragma once

#include "model/force_rate.hpp"
#include "step/solved_step.hpp"

namespace contactvi {

class StageForceRates {
 public:
  explicit StageForceRates(const Tree& tree) : tree_(&tree), field_(tree), any_(forces_depend_on_time(tree.elements)) {}

  // Whether there may be some.
  bool any() const { return any_; }
  // Another step is asked about from now on.
  void forget() { known_ = false; }
  // (nv, s); found once for each step, for functions of users are asked. Throws NoDerivative.
  const MatX& of(SolvedStep& step);

 private:
  const Tree* tree_;
  ForceField field_;
  bool any_, known_ = false;
  MatX rates_;
};

}  // namespace contactvi

// A span of steps in which no guard can close, whatever the motion, as long as it is not faster than expected: such
// steps look at no pair at all.
//
// The span is measured in reference steps, in which every dof goes a given way. A step whose velocities are bounded
// counts as the least part or multiple of a reference step that no dof exceeds. How far a geometry moves in a reference
// step is a bound that grows in proportion, so one number, the reference steps used up, bounds the motion of all
// geometries since the span began. It has to stay below the number after which some guard would have to be looked at.
#pragma once

#include <limits>

#include "base/numerics.hpp"

namespace contactvi {

class ClearSpan {
 public:
  // The longest span, in reference steps: the arms that prismatic joints lengthen are bounded for so long.
  static constexpr double kLongest = 64.0;

  explicit ClearSpan(int nv) : path_(VecX::Zero(nv)), inverse_(VecX::Zero(nv)) {}

  // Sets the ways of the dofs in a reference step, for the steps after one of length h with these bounds on the
  // velocities, (nv,). Nothing is allowed yet.
  const VecX& set_reference(const VecX& bound, double h);
  // Steps are clear while so many reference steps are used up; more is less.
  void allow(double steps) { allowed_ = steps; }
  // Enters a step whose velocities stay within bound. False, and nothing is entered, if it may not be clear: gaps at
  // the end have to be larger than the motion of the step.
  bool take(const VecX& bound, double h);
  // As this, of n dofs whose speeds stay within |rate| + |rate - before|.
  bool take(int n, const double* rate, const double* before, double h);
  // Of the step taken last, in reference steps.
  double last() const { return last_; }
  double used() const { return used_; }
  bool any() const { return used_ > 0.0; }
  void end() { used_ = allowed_ = 0.0; }

 private:
  bool enter(double steps);

  VecX path_, inverse_;  // of each dof in a reference step [m; rad], and one over it
  double used_ = 0.0, allowed_ = 0.0, last_ = 0.0;
};

}  // namespace contactvi

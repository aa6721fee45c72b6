// A span of steps in which no guard can close, whatever the motion, as long as it is not faster than expected: such
// steps look at no pair at all.
//
// The span is measured in reference steps, in which every dof goes a given way. A step whose velocities are bounded
// counts as the least part or multiple of a reference step that no dof exceeds. How far a geometry moves in a reference
// step is a bound that grows in proportion, so one number, the reference steps used up, bounds the motion of all
// geometries since the span began. It has to stay below the number after which some guard would have to be looked at.
#pragma once

#include <limits>
#include <vector>

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
  // Looks ahead: whether a step that follows those foreseen so far may be taken, which then is one of them.
  void look_ahead() { foreseen_.clear(); }
  bool foresee(const VecX& bound, double h) { return enter_foreseen(part(bound) * h); }
  bool foresee(int n, const double* rate, const double* before, double h) {
    return enter_foreseen(part(n, rate, before) * h);
  }
  // Reference steps used up after so many of them, at least one.
  double used_after(int steps) const { return foreseen_[steps - 1].used; }
  void take_foreseen(int steps) {
    used_ = used_after(steps);
    last_ = foreseen_[steps - 1].steps;
  }
  // Of the step taken last, in reference steps.
  double last() const { return last_; }
  double used() const { return used_; }
  bool any() const { return used_ > 0.0; }
  void end() { used_ = allowed_ = 0.0; }

 private:
  struct Foreseen {
    double steps, used;
  };
  double part(const VecX& bound) const;
  double part(int n, const double* rate, const double* before) const;
  bool enter(double steps);
  bool enter_foreseen(double steps);

  VecX path_, inverse_;  // of each dof in a reference step [m; rad], and one over it
  double used_ = 0.0, allowed_ = 0.0, last_ = 0.0;
  std::vector<Foreseen> foreseen_;
};

}  // namespace contactvi

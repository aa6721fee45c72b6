// Where a force law changes its branch inside of a smooth step: a rope becomes slack or taut, an actuator reaches its
// limit.
//
// A step is solved with the branches that hold at its start, also beyond the place where one of them ends, so that its
// equations are smooth. A switch function per branch is positive as long as the branch holds. Its first root is looked
// for on the polynomial of the step, and located on exact partial steps, whose ends are true to the order of the method
// while the polynomial inside of the step is not.
#pragma once

#include <vector>

#include "event/finder.hpp"
#include "step/integrator.hpp"

namespace contactvi {

class SwitchFunctions {
 public:
  virtual ~SwitchFunctions() = default;
  virtual int count() const = 0;
  // Their values at a state of the step, (count,), after the part `at` of it: positive where the branches hold. In
  // units of the sizes of their terms, so that rounding is some 1e-16.
  virtual void evaluate(double at, const VecX& q, const VecX& v, VecRef values) = 0;
  // Whether a function may be zero for a while and its branch hold: it ends where the function is negative.
  virtual bool may_stay_zero(int) const { return false; }
};

// The functions of two kinds, one after the other.
class JoinedSwitches final : public SwitchFunctions {
 public:
  JoinedSwitches(SwitchFunctions& first, SwitchFunctions& second) : first_(&first), second_(&second) {}
  int count() const override { return first_->count() + second_->count(); }
  void evaluate(double at, const VecX& q, const VecX& v, VecRef values) override {
    if (first_->count() > 0) first_->evaluate(at, q, v, values.head(first_->count()));
    if (second_->count() > 0) second_->evaluate(at, q, v, values.tail(second_->count()));
  }
  bool may_stay_zero(int k) const override {
    return k < first_->count() ? first_->may_stay_zero(k) : second_->may_stay_zero(k - first_->count());
  }

 private:
  SwitchFunctions *first_, *second_;
};

class SwitchFinder {
 public:
  SwitchFinder(const Tree& tree, Integrator& integrator, SwitchFunctions& functions);

  // Searches the step of length h from q0, p0 with the velocity v0 to q1, p1, which the integrator has solved last.
  // kFound: which() is the function that comes to zero first, at alpha(); with alpha() > 0 the integrator holds the
  // partial step up to there, which ends at q(), p(). With alpha() = 0 its branch does not hold from the start on.
  Search search(const VecX& q0, const VecX& p0, const VecX& v0, const VecX& q1, const VecX& p1, double h,
                const VecX& tau);
  int which() const { return which_; }
  double alpha() const { return alpha_; }
  const VecX& q() const { return q_; }
  const VecX& p() const { return p_; }
  const VecX& v() const { return v_; }

 private:
  // Values of the functions at a place of the step.
  struct Sample {
    double at;
    VecX values;
  };
  bool clear_by_stages(const VecX& q0, const VecX& v0);
  Sample on_path(double at);
  bool exact(double at, VecX& values);
  Search cross(const Sample& a, const Sample& b);
  Search begins_below(int function);
  Search first(const Sample& a, const Sample& b, double width);
  Search locate(int function, double lo, double hi, double root, double slope);
  bool is_armed(int k) const { return armed_[static_cast<std::size_t>(k)] != 0; }

  const Tree* tree_;
  Integrator* integrator_;
  SwitchFunctions* functions_;
  StepPath path_;
  VecX v1_, q_, p_, v_, q_stage_, v_stage_;
  VecX start_, values_, least_, largest_;
  std::vector<char> armed_;  // functions that have been positive, beyond rounding, in the step
  const VecX *q0_ = nullptr, *p0_ = nullptr, *tau_ = nullptr;
  double h_ = 0.0, alpha_ = 0.0;
  int which_ = -1;
  bool probed_ = false;  // whether partial steps were solved
};

}  // namespace contactvi

// The branches of the piecewise force laws in smooth steps: which ropes pull, which compliant contacts press, which
// actuators are at a limit.
//
// In a smooth step each law is that of one branch, wherever the step goes; where a branch ends the step ends
// (event/switch_finder.hpp). Other steps choose branches at each stage, or for the whole step.
#pragma once

#include <vector>

#include "event/switch_finder.hpp"
#include "run/actuation.hpp"

namespace contactvi {

// Since the reset.
struct SwitchCounts {
  long located = 0;  // switches at which smooth steps have ended
  long jumps = 0;    // of them, those at which a force has a jump: a rope with a damper becomes taut
  long held = 0;     // branches that were held over the rest of a control step, for they would have changed for ever
};

class Branches final : public SwitchFunctions {
 public:
  Branches(const Tree& tree, Actuation& actuation, Integrator& integrator);

  // Whether the scene has no piecewise law.
  bool none() const { return ropes_.empty() && actuation_->limited_dofs().empty(); }
  // A control step begins: no branch is held any more.
  void begin_interval();
  // The next smooth step starts there. keep: with the branches of the one before, which has ended where one of them
  // did; else ropes take those of the state, as the actuators have (Actuation::limit).
  void begin_step(const VecX& q0, const VecX& v0, bool keep);
  // The length of the step that begins there, at most h: shorter near the opening of a compliant contact whose force
  // grows with a broken power of its depth, which no polynomial follows [s]. A nominal length by a power of two.
  double limit(double h, double nominal, const VecX& q, const VecX& v);
  // Whether a compliant contact presses in the step whose law no method keeps the energy of: it is not linear.
  bool presses_nonlinearly() const;
  // It begins at a time and has this length [s].
  void take_step(double t, double h) {
    t0_ = t;
    h_ = h;
  }
  // From now on forces are those of the state.
  void end_step() { integrator_->field().hold_branches(nullptr); }

  int count() const override { return static_cast<int>(active_.size()); }
  void evaluate(double at, const VecX& q, const VecX& v, VecRef values) override;
  // Goes to the branch beyond the root of a function at this time and state, with or without a motion since the last
  // change. False: it is held, for there have been too many changes.
  bool change(int function, double t, const VecX& q, const VecX& v, bool moved);
  // Of the last change: whether it is a switch, and not one that is taken back; and whether the force has a jump there.
  bool switched() const { return switched_; }
  bool jumped() const { return jumped_; }

 private:
  // Of a law: a rope (its number among the springs), a compliant contact (behind all springs) or a joint (its dof).
  struct Law {
    int rope = -1, dof = -1;
    int without_motion = 0;  // changes at one instant
    bool held = false;
  };
  double drive_value(int dof, double t, const VecX& q, const VecX& v, Drive& next) const;

  const Tree* tree_;
  Actuation* actuation_;
  Integrator* integrator_;
  std::vector<int> ropes_;
  std::vector<char> pulls_;  // per spring, and behind them per compliant contact
  std::vector<int> broken_;  // compliant contacts whose exponent is no whole number
  std::vector<Law> laws_;
  std::vector<int> active_;  // laws that have a switch function in the step
  std::vector<Slackness> slackness_;
  VecX q0_, row_, answer_;
  double t0_ = 0.0, h_ = 0.0;
  long changes_ = 0;  // in the control step
  bool switched_ = false, jumped_ = false;
};

}  // namespace contactvi

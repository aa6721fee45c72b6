// The actuation of a control step: inputs and servos within the limits of effort and speed.
#pragma once

#include "contact/contact_step.hpp"
#include "contact/dense_step.hpp"
#include "step/integrator.hpp"
#include "step/node_lanes.hpp"

namespace contactvi {

// A value: part of the state of a run.
struct ActuatorState {
  VecX given, limited;  // generalized force of the step under way: as given, within the limits
  Servo servo;
  // Steps with contact in which actuators were at their limits, and smooth ones in which some were at that of speed.
  long saturated = 0;
};

// The branches of an actuator's law: what is asked for; the least or the largest effort; none, because the joint is at
// its largest speed and would be driven on.
enum class Drive : char { kAsked, kLow, kHigh, kCut };

class Actuation {
 public:
  // The servo of `state` acts in the steps of all three, from the first limit() on.
  Actuation(const Tree& tree, ActuatorState& state, Integrator& free, ContactStep& contact, DenseStep& dense);

  // The velocities at the starts of steps are found side by side with those of other runs from now on.
  void join(NodeCompany& company);

  void start();
  // Sets the input and, if target has rows, the references of the servos (its row k) for the next control step that
  // starts at (q, p).
  void set(double t, const VecX& tau, const MatX& target, long k, const VecX& q, const VecX& p);
  // The references of the servos move by these from the next set() on; null: they are those that set() is given.
  void follow(const MovingReferences* references) {
    state_->servo.moving = references;
    references_.resize(0);
  }
  // Applies the limits of the actuators at a state. Where an actuator is at its limit, its torque is constant until the
  // next part of the step.
  void limit(double t, const VecX& q, const VecX& p);
  // Sets servos that were beyond their effort limit in the step just solved to that limit. True if there were any: the
  // step is to be solved again.
  bool saturate_servos(const StepEquations& step);
  // Joints with limits, by their dofs: those whose actuators have more than one branch. The branch of one, which
  // limit() has chosen; and another one from now on.
  const std::vector<int>& limited_dofs() const { return limited_dofs_; }
  Drive drive(int dof) const { return drive_[static_cast<std::size_t>(dof)]; }
  void enter(int dof, Drive drive);
  bool is_any(Drive drive) const;
  // Whether an actuator was at a limit in the step just made, with contact or without.
  bool is_any_limited() const;
  // Where limit() was called last: the velocity there.
  const VecX& start_velocity() const { return v_; }
  // What is asked of a joint in a part of a step that begins at q0, at a state in it, and the sizes of its terms.
  struct Asked {
    double effort, size;
  };
  Asked asked(int dof, const VecX& q0, double t, const VecX& q, const VecX& v);
  // Whether that changes in a step: there is a servo.
  bool is_driven(int dof) const;
  // Bounds of a joint's actuator; infinite: none.
  double effort_limit(int dof) const;
  double speed_limit(int dof) const;
  // The generalized force of the step under way, within the limits; (nv,) or empty.
  const VecX& force() const { return state_->limited; }
  // To be called after `state` has been restored.
  void apply_servo();

 private:
  // Of a run with company: the lanes for its velocities, and the state in them.
  struct Shared {
    NodeCompany* company;
    FlatModel model;
    StageLanes* lanes;
    Stages node;
    Shared(const Tree& tree, NodeCompany& with);
  };
  double own(int dof) const;
  void set_drive(int dof, Drive drive);
  void find_velocity(const VecX& q, const VecX& p);

  const Tree* tree_;
  ActuatorState* state_;
  Integrator* free_;
  ContactStep* contact_;
  DenseStep* dense_;
  VecX v_;
  std::vector<int> limited_dofs_;
  std::vector<Drive> drive_;  // per dof
  VecX references_;           // of servos that follow moving ones, when asked last, and the time of that [s]
  double references_time_ = 0.0;
  std::unique_ptr<Shared> shared_;
};

}  // namespace contactvi

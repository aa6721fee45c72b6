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
  long saturated = 0;  // actuators at their limits, summed over steps
};

class Actuation {
 public:
  // The servo of `state` acts in the steps of all three, from the first limit() on.
  Actuation(const Tree& tree, ActuatorState& state, Integrator& free, ContactStep& contact, DenseStep& dense);

  // The velocities at the starts of steps are found side by side with those of other runs from now on.
  void join(NodeCompany& company);

  void start();
  // Sets the input and, if target has rows, the references of the servos (its row k) for the next control step that
  // starts at (q, p).
  void set(const VecX& tau, const MatX& target, long k, const VecX& q, const VecX& p);
  // Applies the limits of the actuators at a state. Where an actuator is at its limit, its torque is constant until the
  // next part of the step.
  void limit(const VecX& q, const VecX& p);
  // Sets servos that were beyond their effort limit in the step just solved to that limit. True if there were any: the
  // step is to be solved again.
  bool saturate_servos(const StepEquations& step);
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
  double effort_limit(int d) const;
  void find_velocity(const VecX& q, const VecX& p);

  const Tree* tree_;
  ActuatorState* state_;
  Integrator* free_;
  ContactStep* contact_;
  DenseStep* dense_;
  VecX v_;
  std::unique_ptr<Shared> shared_;
};

}  // namespace contactvi

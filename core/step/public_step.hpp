// One smooth step in public coordinates, solved to rounding: that whose derivatives linearize.hpp and step_gradient.hpp
// take.
#pragma once

#include "step/integrator.hpp"
#include "step/stage_matrices.hpp"

namespace contactvi {

// What stands for the motion beside q in a state.
enum class StateKind { kVelocity, kMomentum };

// A state: x the public velocity or momentum, v and p the engine's.
struct StateView {
  StateKind kind;
  const VecX &q, &x, &v, &p;
};

// Iterations after which a step counts as not solved.
constexpr int kStepIterations = 200;

struct StepInputs {
  double time;  // of the start [s]
  VecX tau;     // generalized force, public coordinates, (nv,) or empty
  Servo servo;  // any is false: none
};

class PublicStep {
 public:
  // The step of length h from (q0, x0), of which the inputs and the integrator must live on; what the integrator did
  // before does not count. Throws Refusal where it cannot be solved.
  PublicStep(const Tree& tree, const VecX& q0, const VecX& x0, StateKind kind, double h, const StepInputs& inputs,
             Integrator& integrator);

  StateKind kind() const { return kind_; }
  // Public.
  const VecX q0, x0;
  VecX q1, x1;
  // Velocity and momentum of the engine at the start and the end.
  VecX v0, p0, v1, p1;

  // Has Derivative, StepTangent or StepAdjoint, take the step.
  template <class Derivative>
  void give(Derivative& derivative) {
    derivative.take(q0, p0, h_, inputs_.tau, inputs_.time, integrator_->servo(), integrator_->velocities());
  }
  // Valid until the equations solve another step.
  StepSolution solution() {
    const bool velocity = kind_ == StateKind::kVelocity;
    return {q0,
            p0,
            h_,
            inputs_.tau,
            inputs_.time,
            integrator_->servo(),
            integrator_->velocities(),
            velocity ? &v0 : nullptr,
            velocity ? &v1 : nullptr};
  }
  StateView start() const { return {kind_, q0, x0, v0, p0}; }
  StateView end() const { return {kind_, q1, x1, v1, p1}; }
  StepEquations& equations() { return *integrator_; }

 private:
  StateKind kind_;
  double h_;
  const StepInputs& inputs_;
  Integrator* integrator_;
};

}  // namespace contactvi

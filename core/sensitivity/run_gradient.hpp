// The gradient of a function of a recorded run.
#pragma once

#include "base/numerics.hpp"
#include "step/step_parameters.hpp"

namespace contactvi {

struct RunGradient {
  VecX q, v;          // in the start, (nv,)
  MatX tau;           // in the inputs, (steps, nv)
  MatX q_ref, v_ref;  // in the references of the servos, (steps, nv)
  VecX e, mu;         // in restitution and friction, (guards,)
  StepParameters parameters;

  // What `parameters` has of the references of servos is that of one step: cleared before it, and entered in its row
  // after it, with the gradient in its inputs.
  void begin_step() {
    parameters.q_ref.setZero();
    parameters.v_ref.setZero();
  }
  void end_step(long step, const VecX& ltau) {
    tau.row(step) += ltau.transpose();
    q_ref.row(step) += parameters.q_ref.transpose();
    v_ref.row(step) += parameters.v_ref.transpose();
  }
};

}  // namespace contactvi

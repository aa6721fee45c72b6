// The derivative of one step with impulses of constraints and joint friction, without contacts, in public coordinates,
// all columns.
#pragma once

#include "model/scene.hpp"
#include "step/linearize.hpp"

namespace contactvi {

// A step of order 2 and of length h from (q0, x0), before which no joint with friction sticks. Throws Refusal where it
// cannot be solved, NoDerivative where a joint is at the limit of its friction.
LinearStep linearize_contact_step(const Scene& scene, const VecX& q0, const VecX& x0, StateKind kind, double h,
                                  const StepInputs& inputs);

// As this, of a smooth step of more stages; tol: of the stage equations. Joints with friction stick and slide all the
// time as they do at its start.
LinearStep linearize_held_step(const Scene& scene, const VecX& q0, const VecX& x0, StateKind kind, double h,
                               const StepInputs& inputs, int stages, double tol);

}  // namespace contactvi

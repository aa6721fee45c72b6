// Directions and gradients at a state, between public coordinates (configuration, and velocity or momentum) and the
// engine's (q, p). Gradients are dual to tangent vectors.
#pragma once

#include "step/public_step.hpp"
#include "step/step_adjoint.hpp"
#include "step/step_tangent.hpp"

namespace contactvi {

// A public direction (dq, dx) becomes the engine's (dq, dp).
void to_engine_direction(const Tree& tree, StepTangent& tangent, const StateView& at, VecX& dq, VecX& dx);
// An engine's direction (dq, dp) becomes the public one (dq, dx).
void to_public_direction(const Tree& tree, StepTangent& tangent, StepEquations& equations, const StateView& at,
                         VecX& dq, VecX& dp);

// The transposes: a gradient in the public (q, x) becomes that in the engine's (q, p), and the reverse. What a velocity
// has of the mass matrix is added to the gradients in its parameters.
void to_engine_gradient(const Tree& tree, StepAdjoint& adjoint, StepEquations& equations, const StateView& at, VecX& lq,
                        VecX& lx, StepParameters& sums);
void to_public_gradient(const Tree& tree, StepAdjoint& adjoint, const StateView& at, VecX& lq, VecX& lp,
                        StepParameters& sums);

}  // namespace contactvi

// The gradient of some function through one smooth step in public coordinates, by the transposed derivative.
#pragma once

#include "step/public_step.hpp"
#include "step/step_adjoint.hpp"

namespace contactvi {

struct StepGradient {
  VecX q, x, tau;  // in the start and in the generalized force, dual to tangent vectors of Pinocchio, (nv,)
  double h;
  StepParameters parameters;
};

// From the gradient (lq, lx) in the end of the step of length h from (q0, x0). Throws Refusal where the step or its
// derivative cannot be solved.
StepGradient pull_back_step(const Tree& tree, const VecX& q0, const VecX& x0, StateKind kind, double h,
                            const StepInputs& inputs, int stages, double tol, const VecX& lq, const VecX& lx);

}  // namespace contactvi

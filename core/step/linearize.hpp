// The derivative of one smooth step in public coordinates, all columns: A and B of the discrete-time linear system.
#pragma once

#include "step/public_step.hpp"

namespace contactvi {

struct LinearStep {
  VecX q1, x1;  // the end: configuration, and velocity or momentum
  MatX A;       // d(q1, x1)/d(q0, x0), (2 nv, 2 nv), tangent vectors of Pinocchio
  MatX B;       // d(q1, x1)/d tau, (2 nv, nv)
  VecX h;       // d(q1, x1)/dh, (2 nv,)
};

// The step of length h from (q0, x0). Throws Error where it or its derivative cannot be solved.
LinearStep linearize_step(const Tree& tree, const VecX& q0, const VecX& x0, StateKind kind, double h,
                          const StepInputs& inputs, int stages, double tol);
// The same of a solved step by one tangent equation per column (step_tangent.hpp): slow, and the reference of tests.
LinearStep linearize_by_columns(const Tree& tree, PublicStep& step, int stages);

// Forces of springs, dampers, servos and elements at a state, without gravity, in public coordinates.
struct LinearForces {
  VecX f;         // (nv,)
  MatX f_q, f_v;  // (nv, nv), tangent vectors of Pinocchio
};
LinearForces linearize_forces(const Tree& tree, const VecX& q, const VecX& v, const StepInputs& inputs);

}  // namespace contactvi

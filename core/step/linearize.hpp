// The derivative of one smooth step in public coordinates, all columns: A and B of the discrete-time linear system.
#pragma once

#include "step/integrator.hpp"
#include "step/step_tangent.hpp"

namespace contactvi {

// What stands for the motion beside q in a state.
enum class StateKind { kVelocity, kMomentum };

struct LinearStep {
  VecX q1, x1;  // the end: configuration, and velocity or momentum
  MatX A;       // d(q1, x1)/d(q0, x0), (2 nv, 2 nv), tangent vectors of Pinocchio
  MatX B;       // d(q1, x1)/d tau, (2 nv, nv)
  VecX h;       // d(q1, x1)/dh, (2 nv,)
};

// The step of length h from (q0, x0) with the generalized force tau, (nv,) or empty, at a time [s]. Throws Error where
// it or its derivative cannot be solved.
LinearStep linearize_step(const Tree& tree, const VecX& q0, const VecX& x0, StateKind kind, double h, const VecX& tau,
                          double time, int stages, double tol);

}  // namespace contactvi

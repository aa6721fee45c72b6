// Energies and momenta of a state (q, p), and the modified Hamiltonian that the midpoint step really conserves.
#pragma once

#include "step/step_equations.hpp"

namespace contactvi {

struct Energy {
  double kinetic, potential;  // [J]; potential: gravity and springs
};

// Engine coordinates. NaN if the mass matrix is not positive.
Energy energy(StepEquations& equations, const VecCRef& q, const VecCRef& p);
// With the velocity v of the momentum p, where it is known.
Energy energy(StepEquations& equations, const VecCRef& q, const VecCRef& p, const VecCRef& v);

// The largest turn of a joint over the step h at the velocities v [rad].
double largest_turn(const Tree& tree, const VecCRef& v, double h);

// The energy that the integrator conserves so well that losses can be measured by it. At order 4 and more it is H
// itself, whose node values stay within O(h^2s). For the midpoint rule it is H~_h = H + h^2 H2 of the undamped,
// unforced system, H2 = -(G.a - dG.v + p.[v,a])/24 with a the free acceleration and dG.v the derivative of G = dL/dq
// along the flow, against v (backward error analysis; on vector spaces -H''(J dH, J dH)/24). It varies O(h^4) where H
// varies O(h^2).
//
// With constraints phi(q, t) = 0, whose steps are the midpoint rule in RATTLE form (contact/contact_step.hpp), a is the
// constrained acceleration, and their forces lambda add lambda.(W^T a)/24 to H2, with W the gradients of phi. t: the
// time of the state [s].
double modified_hamiltonian(StepEquations& equations, const VecCRef& q, const VecCRef& p, double h, double t = 0.0);

// dH/dq at a constant momentum, shape (nv,), tangent vectors body-fixed on spherical joints; v: the velocity at (q, p).
void energy_gradient(StepEquations& equations, const VecCRef& q, const VecCRef& v, VecRef gradient);

// a = M^-1 (forces) at (q, v) and the time t [s]: gravity, springs, damping and the inputs tau (public coordinates, or
// empty), without contact. The node of `equations` must be placed at q.
void forward_dynamics(StepEquations& equations, const VecCRef& q, const VecCRef& v, double t, const VecX& tau,
                      VecRef a);

// Total linear momentum and angular momentum about the origin, world frame, (6,).
Eigen::Matrix<double, 6, 1> spatial_momentum(const Tree& tree, const VecCRef& q, const VecCRef& v);

}  // namespace contactvi

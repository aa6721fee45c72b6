// Energies and momenta of a state (q, p), and the modified Hamiltonian that the midpoint step really conserves.
#pragma once

#include "step/integrator.hpp"

namespace contactvi {

struct Energy {
  double kinetic, potential;  // [J]; potential: gravity and springs
};

// Engine coordinates. NaN if the mass matrix is not positive.
Energy energy(Integrator& integrator, const VecCRef& q, const VecCRef& p);

// What the integrator conserves so well that energies can be compared with it. Order 4 and more: H itself, whose node
// values stay within O(h^2s). Midpoint rule: H~_h = H + h^2 H2 of the undamped, unforced system, H2 = -(G.a - dG.v +
// p.[v,a])/24 with a the free acceleration and dG.v the derivative of G = dL/dq along the flow, against v (backward
// error analysis; on vector spaces -H''(J dH, J dH)/24). It varies O(h^4) where H varies O(h^2).
double modified_hamiltonian(Integrator& integrator, const VecCRef& q, const VecCRef& p, double h);

// a = M^-1 (forces) at (q, v): gravity, springs, damping and the inputs tau (public coordinates, or empty), without
// contact. The integrator's node must be placed at q.
void forward_dynamics(Integrator& integrator, const VecCRef& q, const VecCRef& v, const VecX& tau, VecRef a);

// Total linear momentum and angular momentum about the origin, world frame, (6,).
Eigen::Matrix<double, 6, 1> spatial_momentum(const Tree& tree, const VecCRef& q, const VecCRef& v);

}  // namespace contactvi

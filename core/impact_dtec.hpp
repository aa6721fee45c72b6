// DTEC, the discrete-time energy conserving impact map: the discrete energy E_d = -D_3 L_d, for the midpoint rule
// T(q_m, v) + V(q_m), is the same in the partial steps before and after the impact, less the loss (Fetecau, Marsden,
// Ortiz, West 2003, "Nonsmooth Lagrangian mechanics and variational collision integrators"; Murphey, Pekarek,
// Seghete).
#pragma once

#include "impact.hpp"

namespace contactvi {

// E_d of the step whose solution the integrator holds (its workspace is at the midpoint).
double discrete_energy(Integrator& integrator);

// p becomes p+, shape (nv,). problem.target: E_d before the impact less the loss.
ImpactResult impact_dtec(const ImpactProblem& problem, VecRef p);

}  // namespace contactvi

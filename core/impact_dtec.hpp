// DTEC, the discrete-time energy conserving impact map: the discrete energy E_d = -D_3 L_d, at order 2s the mean sum
// b_i E(q_i, v_i) over the stages, is the same in the partial steps before and after the impact, less the loss
// (Fetecau, Marsden, Ortiz, West 2003, "Nonsmooth Lagrangian mechanics and variational collision integrators";
// Murphey, Pekarek, Seghete).
#pragma once

#include "impact.hpp"

namespace contactvi {

// p becomes p+, shape (nv,). problem.target: E_d before the impact less the loss.
ImpactResult impact_dtec(const ImpactProblem& problem, VecRef p);

}  // namespace contactvi

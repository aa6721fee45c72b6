// DTEC, the discrete-time energy conserving impact map: the discrete energy E_d = -D_3 L_d, at order 2s the mean sum
// b_i E(q_i, v_i) over the stages, is the same in the partial steps before and after the impact, less the loss
// (Fetecau, Marsden, Ortiz, West 2003, "Nonsmooth Lagrangian mechanics and variational collision integrators";
// Murphey, Pekarek, Seghete).
#pragma once

#include "impact/scalar_map.hpp"

namespace contactvi {

// p becomes p+, shape (nv,). problem.target: E_d before the impact less the loss.
ImpactResult impact_dtec(const ImpactProblem& problem, VecRef p);
// The same beside another impulse than CTEC's, that of an impact with friction or several points: p_minus + impulse W
// is what it leads to, and only its size is changed.
ImpactResult impact_dtec(const ImpactProblem& problem, const ImpactResult& ctec, VecRef p);

}  // namespace contactvi

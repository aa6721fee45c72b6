// DTEC, the discrete-time energy conserving impact map: the discrete energy E_d = -D_3 L_d, at order 2s the mean sum
// b_i E(q_i, v_i) over the stages, is the same in the partial steps before and after the impact, less the loss
// (Fetecau, Marsden, Ortiz, West 2003, "Nonsmooth Lagrangian mechanics and variational collision integrators";
// Murphey, Pekarek, Seghete). Its equation has no root for a plastic impact: there is no persistent contact with it.
#pragma once

#include "impact/impact_law.hpp"

namespace contactvi {

const ImpactLaw& dtec_law();

}  // namespace contactvi

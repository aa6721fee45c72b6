// CTEC, the continuous-time energy conserving impact map: H(q_c, p+) = H(q_c, p-) - loss (Murphey, Pekarek, Seghete,
// "Variational Methods for Contact Mechanics"; loss = (1 - e^2) gamma-^2 / (2 G_c) is Newton's restitution).
#pragma once

#include "impact/scalar_map.hpp"

namespace contactvi {

// p is p- on entry and p+ on return, shape (nv,).
ImpactResult impact_ctec(const ImpactProblem& problem, VecRef p);

}  // namespace contactvi

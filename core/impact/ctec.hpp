// CTEC, the continuous-time energy conserving impact map: H(q_c, p+) = H(q_c, p-) - loss (Murphey, Pekarek, Seghete,
// "Variational Methods for Contact Mechanics"; loss = (1 - e^2) gamma-^2 / (2 G_c) is Newton's restitution).
#pragma once

#include "impact/impact_law.hpp"

namespace contactvi {

const ImpactLaw& ctec_law();

// CTEC's impulse, from which the implicit maps start and to which they fall back. p is p- on entry and p+ on return,
// shape (nv,).
ImpactResult explicit_impulse(const ImpactProblem& problem, VecRef p);

}  // namespace contactvi

// Projected sweeps over the natural map: slow, but they need no more of a problem than that its matrix is positive.
#pragma once

#include "cone/natural_map.hpp"

namespace contactvi {

// Contact by contact lambda becomes the projection of lambda - r w, `sweeps` times; map: prepared for the problem.
void projected_sweeps(const ConeProblem& problem, const NaturalMap& map, int sweeps, double* lambda);

}  // namespace contactvi

// The impact maps of the engine: the only place that tells them apart.
#pragma once

#include "impact/impact_law.hpp"

namespace contactvi {

// Throws Error for a number that is no map.
const ImpactLaw& impact_law(ImpactMap map);

}  // namespace contactvi

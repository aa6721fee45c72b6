// Which laws of contact have derivatives.
#pragma once

#include "model/scene.hpp"

namespace contactvi {

// Throws NoDerivative where the friction of a guard depends on the speed or the direction of its slip, or on a surface
// that moves along itself, is larger at rest, or where it adheres; time: of the contact [s].
void require_known_law(const Scene& scene, int guard, double time);

}  // namespace contactvi

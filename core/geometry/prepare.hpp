// What is computed of a scene's geometries once, after loading, and shared by all simulators.
#pragma once

#include "model/scene.hpp"

namespace contactvi {

// Makes the shape features that pairs need and are not made yet, and the pair table. Throws Error for a hull without
// triangles.
void prepare_geometry(Scene& scene);

}  // namespace contactvi

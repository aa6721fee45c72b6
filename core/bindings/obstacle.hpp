// Why there is no derivative, for Python.
#pragma once

#include "bindings/arrays.hpp"
#include "model/scene.hpp"
#include "sensitivity/recorded_run.hpp"

namespace contactvi {

// reason, time, and kind and index of the guard.
Dict place_of(const Scene& scene, const Obstacle& at);
// These, and fact, expected, got, remedy.
Dict obstacle_of(const Scene& scene, const NoDerivative& reason);

}  // namespace contactvi

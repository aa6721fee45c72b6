// Why there is no derivative, for Python.
#pragma once

#include "bindings/arrays.hpp"
#include "model/scene.hpp"
#include "sensitivity/recorded_run.hpp"

namespace contactvi {

// fact, reason, expected, got, remedy, time, and kind and index of the guard.
Dict obstacle_of(const Scene& scene, const NoDerivative& reason);

}  // namespace contactvi

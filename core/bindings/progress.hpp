// Progress callbacks of Python as those of the engine.
#pragma once

#include <nanobind/nanobind.h>

#include <optional>

#include "run/simulator.hpp"

namespace contactvi {

using ProgressCallback = nanobind::typed<nanobind::callable, nanobind::object(double, long)>;

// Takes the interpreter lock, looks at signals and calls the callback, if there is one. An error ends the run and is
// kept in UserErrors. The callback stays the caller's.
Progress wrapped(const std::optional<ProgressCallback>& callback);

}  // namespace contactvi

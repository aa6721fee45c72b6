// A run that the engine keeps, as Python holds it.
#pragma once

#include <nanobind/nanobind.h>

#include "run/kept_run.hpp"

namespace contactvi {

// A run with what belongs to it.
struct OwnRun {
  KeptRun run;
  const Scene* scene;
  SimulatorOptions options;
  nanobind::object owner;  // of the scene
  bool planned;            // its steps are parts of those of another one

  // The run as one that can be compared. Throws Error for one without polynomials, or that was handed over.
  const KeptRun& compared() const;
};

}  // namespace contactvi

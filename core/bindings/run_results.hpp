// What the engine recorded of a run as dicts of arrays, in the numbers and coordinates of the Python API.
#pragma once

#include "bindings/arrays.hpp"
#include "bindings/kept_contact_steps.hpp"
#include "run/simulator.hpp"

namespace contactvi {

// Enters the fields of a status.
void add_status(const Scene& s, const Status& status, nanobind::dict& d);
// The polynomials of steps; they are moved from.
Dict segments(const Tree& tree, int stages, Segments& s);
// All that a call of the engine did, besides "error", and "forced" (whether some input was not zero), which the caller
// knows. The recording is moved from. Entries of which there is nothing
// are None, because an array costs as much time as a step of a small model.
Dict run_results(const Scene& s, const SimulatorOptions& options, Recording& recording, const RunState& state,
                 const EngineCounters& counters, KeptContactSteps kept, const Status& status, double seconds);

}  // namespace contactvi

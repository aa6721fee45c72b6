// Runs of parts of a scene, over the whole time, as one run.
#pragma once

#include <vector>

#include "run/kept_run.hpp"

namespace contactvi {

// The run of the whole scene, without polynomials: its nodes are those of one part, the leader, up to the earliest end
// of a part. The states of the others between their own nodes are as exact as these where no contacts persist, and
// those of the polynomials where some do; work and reactions are in proportion to the time there.
KeptRun joined(const Scene& whole, const SimulatorOptions& options, const std::vector<PartRun>& runs,
               std::size_t leader);

}  // namespace contactvi

// Which parts of a scene, each of which was run alone over the whole time, may have met.
#pragma once

#include <utility>
#include <vector>

#include "run/kept_run.hpp"

namespace contactvi {

// Pairs of parts, by their places in the list, whose geometries may have come nearer than `near` [m] to each other: all
// others are certain to have stayed apart. A pair of geometries whose distance was d stays apart until both together
// have moved by d; there it is looked at again. options: of the runs.
std::vector<std::pair<int, int>> meetings(const Scene& whole, const StaticTrees& trees, const SimulatorOptions& options,
                                          const std::vector<PartRun>& runs, double near);

}  // namespace contactvi

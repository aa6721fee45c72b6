// Parts of a scene that are run apart, each over the whole time: whether they may have met, and their runs as one.
#pragma once

#include <utility>
#include <vector>

#include "run/kept_run.hpp"

namespace contactvi {

// A run of a part of the scene.
struct PartRun {
  const SubScene* part;
  const KeptRun* run;
};

// Pairs of parts, by their places in the list, whose geometries may have come nearer than `near` [m] to each other: all
// others are certain to have stayed apart. A pair of geometries whose distance was d stays apart until both together
// have moved by d; there it is looked at again. options: of the runs.
std::vector<std::pair<int, int>> meetings(const Scene& whole, const StaticTrees& trees, const SimulatorOptions& options,
                                          const std::vector<PartRun>& runs, double near);

// The run of the whole scene, without polynomials: its nodes are those of one part, the leader, up to the earliest end
// of a part. The states of the others between their own nodes are as exact as these where no contacts persist, and
// those of the polynomials where some do; work and reactions are in proportion to the time there.
KeptRun joined(const Scene& whole, const SimulatorOptions& options, const std::vector<PartRun>& runs,
               std::size_t leader);

}  // namespace contactvi

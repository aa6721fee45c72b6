// Runs that are kept in the engine.
#pragma once

#include "run/world.hpp"
#include "step/guide.hpp"
#include "step/segment_paths.hpp"

namespace contactvi {

// A run that has ended, with the polynomials of its steps.
struct KeptRun {
  Recording recording;
  RunState state;
  EngineCounters counters;
  Status status;
  double seconds = 0;                // wall time
  MovingReferences references = {};  // of the servos; empty: they are constant

  Eigen::Map<const VecX> configuration(const Tree& tree, std::size_t node) const {
    return {recording.q.data() + node * static_cast<std::size_t>(tree.nq), tree.nq};
  }
};

// A run of a part of the scene.
struct PartRun {
  const SubScene* part;
  const KeptRun* run;
};

// The segments of a recording, as those who read them take them.
SegmentArrays arrays_of(const Segments& segments);
// When the impacts of a recording were [s].
std::vector<double> impact_times(const Recording& recording);

// The largest distance of a node from the first one [m, rad].
double motion_size(const Tree& tree, const KeptRun& run);
// Whether it counts work or reactions, which are known at its nodes alone.
bool counts_work(const Recording& recording);
// Lengths of the steps with persistent contacts together [s].
double contact_time(const KeptRun& run);

}  // namespace contactvi

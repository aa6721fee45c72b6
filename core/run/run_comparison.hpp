// How far two kept runs are apart, and what their steps tell about their errors.
#pragma once

#include "run/kept_run.hpp"

namespace contactvi {

// |q - q'| of two runs at some nodes of the second, at most `times` of them, [m, rad]: the last one, and others that
// are spread evenly over the time, or one in each of as many parts with equally many nodes; or evenly over the nodes of
// both, where there are so many. Infinite where one of the two ended much earlier, unless `ended` is true: then up to
// the earlier end. options: of the first, whose states at these times are found as closely as its nodes are.
VecX distances(const Scene& scene, const SimulatorOptions& options, const KeptRun& other, const KeptRun& found,
               int times, bool over_time, bool ended);

// The error of a run over what that of its companion is larger, by the lengths h of their segments: an error is the sum
// of h^power. Lengths are counted in the adaptive steps that `found` has at the time, because the factor of the law has
// made these so long; with persistent contacts as the squares of those times h, in its contact steps of
// dt_contact [s]. Infinite where flights (between two impacts) that matter have almost the same segments in both runs,
// or where the runs do not meet the same impacts; NaN where the segments tell nothing because contacts persist in both
// and the impacts differ.
double error_share(const KeptRun& companion, const KeptRun& found, int power, double dt_contact);

// The largest distance between a step and two halves of it, of the first steps of some flights [m, rad]; infinite where
// the halves are not solved. A stiff motion that damping ends within a step or two has an error there that later nodes
// do not show, and two runs are no comparison in their first step: up to its end both have made one. Zero for trees
// without damping, whose later nodes show every error.
double first_step_error(const Scene& scene, const SimulatorOptions& options, const KeptRun& run);

}  // namespace contactvi

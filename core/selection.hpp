// Which of many candidates stand for a contact: a few that span its area.
#pragma once

#include <vector>

#include "candidates.hpp"

namespace contactvi {

// Two candidates nearer than this [m], seen along the normal, are one point.
constexpr double kSamePlace = 1e-7;
// Gaps that differ less [m] are equal: which of a resting face's corners is the deepest by rounding must not matter.
constexpr double kSameGap = 1e-11;

// chosen: indices of at most `most` candidates, ascending: the deepest, then each time the one that adds most to the
// area of their convex hull seen along n (world frame); none that adds nothing.
void select_candidates(const std::vector<Candidate>& candidates, const Vec3& n, int most, std::vector<int>& chosen);

}  // namespace contactvi

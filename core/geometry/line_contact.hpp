// Contact along a line: edges of polytopes and axes of capsules and cylinders, each swept by a radius.
//
// Parallel lines touch along the segment that they have in common, and a line that lies on the end of a cylinder
// touches it along a chord. Such a contact has two points, the ends of the segment, each with a gap of its own:
//   kEndA, kEndB   the end of a capsule's axis or of an edge, over the other line: a sphere against a line
//   kRimLineA, B   the rim of a cylinder against a line, at the end of its side or where a chord of its end leaves it:
//                  a circle against a line, at a place where the two are nearest
// Both stay what they are when the bodies tip. Lines that cross at an angle are nearest between the ends, in one point.
#pragma once

#include "geometry/contact_features.hpp"

namespace contactvi {

// Lines whose swept radii add up to less have no side to touch with [m].
constexpr double kLeastSweep = 1e-6;

// How far the one point of two lines may run along them in a step, of the shorter line: where it runs further, what it
// is at the start of the step does not predict what it is at the end.
constexpr double kMostRun = 0.1;

// The nearest points of two lines, not swept; of parallel lines those at an end.
void nearest_on_lines(const Line& a, const Line& b, Vec3& on_a, Vec3& on_b);

// Whether the gap of two lines, which are nearly parallel, is least at an end of the segment that they have in common,
// to rounding: they touch at both ends if they lie on each other, and where they cross in the view along their common
// normal is ill-defined.
bool are_flat(const Line& a, const Line& b);

// Moves x along the circle about `center` to where it is nearest to the line through `origin` along the unit vector
// `direction`. Returns the vector from the line to x, orthogonal to the line.
Vec3 nearest_on_rim(const Vec3& center, const Vec3& axis, double radius, const Vec3& origin, const Vec3& direction,
                    Vec3& x);

// Lists the ends of edge i of a and edge j of b, which are these lines, and the rims of their shapes over each other.
// upcoming: also those that would touch next, when the bodies have tipped by up to 0.1 rad.
void list_line_ends(const PairView& v, int i, const Line& a, int j, const Line& b, bool upcoming, CandidateSink& sink);

}  // namespace contactvi

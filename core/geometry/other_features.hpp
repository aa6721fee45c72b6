// Whether two polytopes touch in some points and nowhere else, and for how long they do.
//
// Vertices of one shape on a face of the other, and two edges that cross, have a common normal. The planes across it
// through what touches separate the two as long as the rest of both shapes lies behind them: then no gap of the pair is
// less than those of the points.
#pragma once

#include "geometry/contact_features.hpp"
#include "geometry/contact_point.hpp"

namespace contactvi {

// The sine of the angle at which two edges cross, 1 for vertices on a face; 0 for points and shapes of other kinds. The
// normal turns by no more than the bodies over this.
double crossing_of(const PairView& v, const ContactPoint* const* points, int count);
// Whether all vertices but those of the points lie behind the planes, of points with a crossing. A rounded hull has
// several vertices where the sharp one has one, which may lie on a plane to rounding: slack.
struct Behind {
  double per_distance;  // by more than so much of their distances from the line of the edge, or from the first vertex,
  double slack;         // [m] less this
};
bool others_behind(const PairView& v, const ContactPoint* const* points, int count, const Behind& by);

}  // namespace contactvi

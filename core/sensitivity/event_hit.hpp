// Which contact points an event of a recorded run is the hit of: those whose gaps determine its time.
#pragma once

#include "sensitivity/recorded_run.hpp"

namespace contactvi {

struct EventHit {
  int impact;                               // the first one in which they take part
  std::vector<const ContactPoint*> points;  // empty: the only one of that impact
};

// Whether a guard, or a point of it, has a persistent contact in the piece.
bool persists(const Piece& piece, int guard);
bool persists(const Piece& piece, const ContactPoint& point);

// The hit at the end of a piece; what persists only takes part in its impacts. Several points are hit at one instant
// where the motion brings them down together, as the second edge of a face that tips about its first one. Throws
// NoDerivative where they had impacts one after the other, unless take_branch.
EventHit event_hit(const RecordedRun& run, const Piece& piece, bool take_branch);

}  // namespace contactvi

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

// Throws NoDerivative for points that are hit one after the other along some direction.
NoDerivative points_apart(const RecordedImpact& impact, const EventHit& hit);
// Of the terms of the gaps' changes: points that are hit together along a direction have the same time to this.
constexpr double kTogether = 1e-8;

// Throws NoDerivative for a persistent contact that begins at the end of a piece without an impact: contacts begin with
// impacts, or are there at the start of the run.
void check_beginnings(const RecordedRun& run, const Piece& piece, const Piece& next);
// Throws NoDerivative for an event at a node, beside a contact step (next: null at the end of the run): what would
// follow is a contact step of no length.
void check_node(const Piece& piece, const Piece* next);

}  // namespace contactvi

#include "sensitivity/event_hit.hpp"

#include <algorithm>

namespace contactvi {

namespace {

// The points of an impact that were not in contact before; of an impact of one point null.
std::vector<const ContactPoint*> new_points(const RecordedRun& run, const Piece& piece, int impact) {
  const RecordedImpact& first = run.impacts[impact];
  if (first.block == nullptr) {
    if (persists(piece, first.guard)) return {};
    return {nullptr};
  }
  std::vector<const ContactPoint*> points;
  for (const ImpactBlockRecord::Member& member : first.block->members) {
    bool acts = false;
    for (int i = 0; i < first.records(); ++i) acts |= run.impacts[impact + i].guard == member.guard;
    if (!acts) continue;
    for (const ContactPoint& point : member.points)
      if (!persists(piece, point)) points.push_back(&point);
  }
  return points;
}

// The points that persist in a piece, of a contact step or of a held one.
std::vector<ContactPoint> persistent_points(const Piece& piece) {
  std::vector<ContactPoint> points;
  if (piece.contact != nullptr)
    for (const ContactStepRecord::Contact& c : piece.contact->contacts) points.push_back(c.before.point);
  if (piece.held != nullptr)
    for (const PersistentContact& c : piece.held->contacts) points.push_back(c.point);
  return points;
}

// Whether a point is one of those hit first, of a guard hit first if it is not known.
bool is_known(const RecordedRun& run, const EventHit& hit, int guard, const ContactPoint* point) {
  if (hit.points.empty()) return run.impacts[hit.impact].guard == guard;
  return std::any_of(hit.points.begin(), hit.points.end(), [&](const ContactPoint* known) {
    return point == nullptr ? known->guard == guard : same_point(*known, *point);
  });
}

}  // namespace

bool persists(const Piece& piece, int guard) {
  if (piece.dense != nullptr) {
    const auto& contacts = piece.dense->contacts;
    return std::any_of(contacts.begin(), contacts.end(),
                       [&](const DenseStepRecord::Contact& c) { return c.closed && c.point.guard == guard; });
  }
  const std::vector<ContactPoint> points = persistent_points(piece);
  return std::any_of(points.begin(), points.end(), [&](const ContactPoint& p) { return p.guard == guard; });
}

bool persists(const Piece& piece, const ContactPoint& point) {
  const std::vector<ContactPoint> points = persistent_points(piece);
  return std::any_of(points.begin(), points.end(), [&](const ContactPoint& p) { return same_point(p, point); });
}

EventHit event_hit(const RecordedRun& run, const Piece& piece, bool take_branch) {
  EventHit hit{-1, {}};
  const int last = piece.first_impact + piece.impacts;
  for (int i = piece.first_impact; i < last; i += run.impacts[i].records()) {
    const std::vector<const ContactPoint*> points = new_points(run, piece, i);
    if (hit.impact < 0) {
      if (points.empty()) continue;
      hit.impact = i;
      if (points[0] != nullptr) hit.points = points;
      continue;
    }
    if (take_branch) continue;
    for (const ContactPoint* point : points) {
      const RecordedImpact& impact = run.impacts[hit.impact];
      if (is_known(run, hit, point == nullptr ? run.impacts[i].guard : point->guard, point)) continue;
      throw NoDerivative({"simultaneous", impact.guard, impact.time}, "Several contacts are hit at one instant",
                         "one contact at a time", std::to_string(piece.impacts) + " impacts",
                         "Start elsewhere; on_kink='taken' gives the derivative of the order that was taken");
    }
  }
  if (hit.impact >= 0) return hit;
  const RecordedImpact& impact = run.impacts[piece.first_impact];
  throw NoDerivative({"witness", impact.guard, impact.time}, "A further point of a pair in persistent contact is hit",
                     "a point that is known", "one that is not", "End the run before");
}

NoDerivative points_apart(const RecordedImpact& impact, const EventHit& hit) {
  return {{"witness", impact.guard, impact.time},
          "An impact has several new points at once",
          "one point that hits first, or points that all directions bring down together",
          std::to_string(hit.points.size()) + " points",
          "Start a little tilted, so that one hits first; on_kink='taken' gives the derivative by the first one"};
}

void check_beginnings(const RecordedRun& run, const Piece& piece, const Piece& next) {
  for (const ContactPoint& point : persistent_points(next)) {
    const int guard = point.guard;
    bool known = persists(piece, guard);
    for (int i = 0; i < piece.impacts; ++i) known |= run.impacts[piece.first_impact + i].guard == guard;
    if (known) continue;
    throw NoDerivative({"grazing", guard, next.t}, "A persistent contact begins without an impact", "a closing speed",
                       "a gap that closes at no speed", "Start elsewhere");
  }
}

void check_node(const Piece& piece, const Piece* next) {
  if (!piece.has_rows() && (next == nullptr || !next->has_rows())) return;
  throw NoDerivative({"node", -1, piece.t + piece.h}, "An event beside a persistent contact is at the end of a step",
                     "events inside of steps", "one at the end", "Use another dt");
}

}  // namespace contactvi

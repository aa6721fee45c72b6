// Simulator: which contacts are held, from events to steps, and what the recording says of them.
#include <algorithm>
#include <cmath>
#include <limits>

#include "run/simulator.hpp"

namespace contactvi {

namespace {
constexpr double kZenoFlight = 0.05;     // of a step: e times the last flight below it ends the bouncing
constexpr double kElasticFlight = 1e-2;  // the same of e = 1, where the forces take energy
constexpr double kShortFlight = 6e-4;    // of the longest flight: what a step counts for there at most
constexpr int kZenoFlights = 4;          // flights in a row, each shorter than the one before
constexpr int kShortHits = 8;            // flights in a row below kZenoFlight of a step, shrinking or not
constexpr double kStays = 1e-11;         // of the speeds: a closed contact slower than this is held
constexpr double kHardly = 1e5;     // of that: a contact that was held leaves so slowly that the step may decide it
constexpr double kLow = 2e6;        // the same for several points: lower than their gaps differ by
constexpr double kLeaves = 1e-10;   // of the speeds: a held one faster than this has left
constexpr double kUnloaded = 1e-9;  // of the forces: less is none
constexpr double kOpen = 1e-9;      // [m] a gap of a pair beyond which none of its points is held any more
constexpr double kApart = 1e-12;    // [m] a gap beyond which a contact without load has left
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
}  // namespace

void Simulator::note(double time, const ContactPoint& point, Change change, double value, Recording& recording) const {
  recording.changes.push_back({time, point.guard, point.feature, change, value});
}

void Simulator::note_phase(double time, double dt, bool persistent, Recording& recording) const {
  if (!recording.phase_t.empty() && recording.phase_persistent.back() == (persistent ? 1 : 0) &&
      recording.phase_dt.back() == dt)
    return;
  if (recording.phase_t.empty() && !recording.t.empty() && recording.t.front() < time) {
    recording.phase_t.push_back(recording.t.front());
    recording.phase_dt.push_back(level_ > 0.0 ? adaptive_h_ : options_.dt);
    recording.phase_persistent.push_back(0);
  }
  recording.phase_t.push_back(time);
  recording.phase_dt.push_back(dt);
  recording.phase_persistent.push_back(persistent ? 1 : 0);
}

// Guards and the search learn which points are held.
void Simulator::sync_persistent() {
  for (int g : persistent_guards_) guards_.set_persistent(g, {});
  persistent_guards_.clear();
  for (const PersistentContact& persistent : contact_step_.contacts()) {
    const int g = persistent.point.guard;
    if (std::find(persistent_guards_.begin(), persistent_guards_.end(), g) != persistent_guards_.end()) continue;
    std::vector<const ContactPoint*> points;
    for (const PersistentContact& other : contact_step_.contacts())
      if (other.point.guard == g) points.push_back(&other.point);
    guards_.set_persistent(g, std::move(points));
    persistent_guards_.push_back(g);
  }
  contact_step_.changed();
}

PersistentContact Simulator::make_persistent(const ContactPoint& point, const Contact& contact, const Vec3& slip) {
  PersistentContact persistent;
  persistent.point = point;
  persistent.mu = scene_->friction(point.guard);
  persistent.tangent = any_tangent(contact.normal);
  if (point.kind == PointKind::kVertex && point.plane_body >= 0)
    persistent.tangent = guards_.placements().R_W[point.plane_body].transpose() * persistent.tangent;
  persistent.slip = slip;
  persistent.sticks = slip.norm() <= kStays * (1.0 + v_.cwiseAbs().maxCoeff());
  return persistent;
}

// After an event: what is closed and neither closes nor separates is held from now on, and the guard `forced`.
void Simulator::hold_closed(int forced, double time, const VecX& tau, Recording& recording) {
  guards_.place(q_);
  integrator_.node_velocity(q_, p_, v_);
  const double slow = kStays * (1.0 + v_.cwiseAbs().maxCoeff());
  kept_.swap(contact_step_.contacts());
  std::vector<PersistentContact>& now = contact_step_.contacts();
  now.clear();
  for (int i = 0; i < sequence_.count(); ++i) {
    ClosedGuard& c = sequence_.closed(i);
    bool all = true;
    const std::size_t first_of_guard = now.size();
    for (int k = 0; k < c.count; ++k) {
      const double gamma = c.gamma_n(k, p_);
      const std::pair<int, std::int64_t> key(c.guard, c.points[k].feature);
      const auto left = std::find(separated_.begin(), separated_.end(), key);
      if (left != separated_.end()) {
        if (!c.hit && c.guard != forced) {
          all = false;  // it has just left and has not closed again
          continue;
        }
        separated_.erase(left);
      }
      double hardly = slow * (c.count > 1 ? kLow : c.persistent ? kHardly : 0.0);
      if (c.persistent && without_progress_ >= kStandstill) hardly = INFINITY;  // contacts that push each other out
      if (std::abs(gamma) > slow && c.guard != forced && !(gamma > 0.0 && gamma < hardly)) {
        all = false;
        continue;
      }
      Vec3 slip = Vec3::Zero();
      if (c.mu > 0.0) {
        const int r = 3 * k;
        slip = c.speed(r + 1, p_) * c.t1[k] + c.speed(r + 2, p_) * c.contacts[k].normal.cross(c.t1[k]);
      }
      PersistentContact persistent = make_persistent(c.points[k], c.contacts[k], slip);
      const PersistentContact* before = nullptr;
      for (const PersistentContact& old : kept_)
        if (old.point.guard == c.guard && old.point.kind == c.points[k].kind &&
            old.point.feature == c.points[k].feature)
          before = &old;
      if (before != nullptr) {
        persistent.tangent = before->tangent;
        if (persistent.sticks && before->anchored && !c.hit) {
          persistent.anchored = true;
          persistent.anchor = before->anchor;
        }
      } else {
        persistent.force[1] = -1.0;  // new
      }
      now.push_back(persistent);
    }
    // Of a face that stays as a whole those that span it are enough.
    if (all && c.chosen < c.count && c.chosen > 2) now.resize(first_of_guard + c.chosen);
    if (all && c.count > 0) finder_.set_touching(c.guard, false);
  }
  leave_unloaded(forced, tau);
  for (const PersistentContact& persistent : now)
    if (persistent.force[1] < 0.0) note(time, persistent.point, Change::kBegin, 0.0, recording);
  for (PersistentContact& persistent : now) persistent.force.setZero();
  for (const PersistentContact& old : kept_) {
    bool stays = false;
    for (const PersistentContact& persistent : now)
      stays |= persistent.point.guard == old.point.guard && persistent.point.feature == old.point.feature;
    if (!stays) note(time, old.point, Change::kRelease, 0.0, recording);
  }
  sync_persistent();
}

// New contacts that no force presses together, or that separate at once, stay touching guards: steps stay smooth ones.
void Simulator::leave_unloaded(int forced, const VecX& tau) {
  std::vector<PersistentContact>& now = contact_step_.contacts();
  bool any = false;
  for (const PersistentContact& persistent : now) any |= persistent.force[1] < 0.0 && persistent.point.guard != forced;
  if (!any) return;
  sync_persistent();
  if (!contact_step_.persistent_forces_at(q_, p_, tau, forces_)) return;
  const double scale = contact_step_.force_scale();
  for (int i = static_cast<int>(now.size()) - 1; i >= 0; --i) {
    if (now[i].force[1] >= 0.0 || now[i].point.guard == forced || forces_[i] > kUnloaded * scale) continue;
    finder_.set_touching(now[i].point.guard, true);
    now.erase(now.begin() + i);
  }
}

// What touches at the start of a run and does not move apart is held.
void Simulator::hold_at_start() {
  std::vector<int> touching;
  for (int g = 0; g < guards_.count(); ++g)
    if (finder_.touching(g)) touching.push_back(g);
  if (touching.empty() || !sequence_.collect(q_, p_, time_, touching, -1, {})) return;
  Recording begun;
  hold_closed(-1, time_, VecX(), begun);
  begun_ = begun.changes;
}

// After a held step: contacts without load that have separated are dropped, changes noted.
void Simulator::drop_leaving(double time, Recording& recording) {
  std::vector<PersistentContact>& contacts = contact_step_.contacts();
  const std::vector<ContactOutcome>& outcomes = contact_step_.outcomes();
  const double fast = kLeaves * (1.0 + contact_step_.end_velocity().cwiseAbs().maxCoeff());
  bool dropped = false;
  for (int i = static_cast<int>(contacts.size()) - 1; i >= 0; --i) {
    const ContactOutcome& out = outcomes[i];
    const double apart =
        guards_.is_noisy(contacts[i].point.guard) ? guards_.root_tolerance(contacts[i].point.guard) : kApart;
    const bool leaves = i == releasing_ || (out.start[0] <= 0.0 && out.contact.gap > apart) || out.w_n > fast;
    if (!leaves) continue;
    const ContactPoint point = contacts[i].point;
    note(time, point, Change::kRelease, 0.0, recording);
    contacts.erase(contacts.begin() + i);
    finder_.set_touching(point.guard, true);
    separated_.emplace_back(point.guard, point.feature);
    if (i == releasing_) finder_.exempt(point.guard);
    dropped = true;
  }
  releasing_ = -1;
  if (dropped) sync_persistent();
}

// Against a halfspace points stay what they are while they are valid.
bool Simulator::points_may_change(int guard) {
  const Pair& pair = scene_->pairs[guard];
  if (!scene_->geometries[pair.a].unbounded && !scene_->geometries[pair.b].unbounded) return true;
  guards_.place(q_);
  for (const PersistentContact& persistent : contact_step_.contacts())
    if (persistent.point.guard == guard && persistent.point.kind != PointKind::kWitness &&
        !guards_.manifolds().valid(persistent.point, guards_.placements()))
      return true;
  return false;
}

// All points of a guard are free again.
void Simulator::let_go(int guard, double time, Recording& recording) {
  std::vector<PersistentContact>& contacts = contact_step_.contacts();
  for (int i = static_cast<int>(contacts.size()) - 1; i >= 0; --i) {
    if (contacts[i].point.guard != guard) continue;
    note(time, contacts[i].point, Change::kRelease, 0.0, recording);
    contacts.erase(contacts.begin() + i);
  }
  finder_.set_touching(guard, false);
  sync_persistent();
}

// Points of faces change as bodies slide on each other: they are found again at the node. What has closed meanwhile is
// hit.
bool Simulator::refresh_points(const Piece& piece, Recording& recording) {
  bool changed = false;
  int first = -1;
  for (PersistentContact& persistent : contact_step_.contacts()) {
    if (persistent.point.kind != PointKind::kRim) continue;
    guards_.place(q_);
    guards_.manifolds().renew(persistent.point, guards_.placements());
  }
  for (int g : persistent_guards_) {
    if (!scene_->is_pair(g) || !points_may_change(g)) continue;
    guards_.place(q_);
    Contact witness;
    const double gap = guards_.evaluate_witness(g, witness), margin = std::max(guards_.touch_tolerance(g), gap);
    if (gap > std::max(guards_.touch_tolerance(g), kOpen)) {
      lost_.push_back(g);  // its points went over an edge in the last step
      continue;
    }
    points_.clear();
    guards_.manifolds().find(g, guards_.placements(), witness, margin + 1e-12, points_);
    for (std::size_t k = separated_.size(); k-- > 0;) {
      if (separated_[k].first != g) continue;
      bool near = false;
      for (const ContactPoint& p : points_) near |= p.feature == separated_[k].second;
      if (!near) separated_.erase(separated_.begin() + static_cast<std::ptrdiff_t>(k));
    }
    points_.erase(std::remove_if(points_.begin(), points_.end(),
                                 [&](const ContactPoint& p) {
                                   const std::pair<int, std::int64_t> key(g, p.feature);
                                   return std::find(separated_.begin(), separated_.end(), key) != separated_.end();
                                 }),
                  points_.end());
    bool same = true;
    int persistent_count = 0;
    for (const PersistentContact& persistent : contact_step_.contacts()) {
      if (persistent.point.guard != g) continue;
      ++persistent_count;
      bool found = false;
      for (const ContactPoint& p : points_)
        found |= p.kind == persistent.point.kind && p.feature == persistent.point.feature;
      same &= found;
    }
    if (same && persistent_count == static_cast<int>(points_.size())) continue;
    changed = true;
    first = g;
  }
  for (int g : lost_) let_go(g, piece.start + piece.done, recording);
  lost_.clear();
  if (!changed) return true;
  // As at an event: what closes is hit, what neither closes nor separates is held.
  const std::vector<int> none(persistent_guards_);
  if (!sequence_.collect(q_, p_, piece.start + piece.done, none, first, {}))
    return end(sequence_.code(), piece.start + piece.done, sequence_.message());
  const Instant now{piece.start + piece.done, 0.0, piece.remaining, piece.tau, step_};
  const double slow = kLeaves * (1.0 + contact_step_.end_velocity().cwiseAbs().maxCoeff());
  double worst = 0.0;
  for (int i = 0; i < sequence_.count(); ++i) worst = std::min(worst, sequence_.closed(i).gamma_n(p_));
  if (worst < -slow) {
    find_accumulating(now.time);
    if (!run_impacts(now, recording)) return end(sequence_.code(), now.time, sequence_.message(), sequence_.guard());
  }
  hold_closed(-1, now.time, piece.tau, recording);
  return true;
}

void Simulator::record_contacts_of_step(double time, double h, Recording& recording) {
  const std::vector<ContactOutcome>& outcomes = contact_step_.outcomes();
  const double force_share = 10.0;  // of the force before: an impulse beyond it is an impact without collision
  for (std::size_t i = 0; i < outcomes.size(); ++i) {
    const PersistentContact& persistent = contact_step_.contacts()[i];
    const ContactOutcome& out = outcomes[i];
    const double now = time + h;
    if (persistent.mu > 0.0 && persistent.sticks != !out.slips)
      note(now, persistent.point, out.slips ? Change::kSlip : Change::kStick, 0.0, recording);
    // An impulse that does not go to zero with the step is the impact without collision of the paradox.
    const double sudden = (out.start[0] + out.end[0]) / h;
    const bool jumps = persistent.force[0] > 0.0 && !persistent.sticks && out.paradox < 1.0 &&
                       sudden > force_share * persistent.force[0];
    if (persistent.mu > 0.0 && (out.paradox <= 0.0 || jumps))
      note(time, persistent.point, Change::kInconsistent, out.paradox, recording);
    if (!options_.record_contacts) continue;
    if (!scene_->is_pair(persistent.point.guard)) {
      // A joint limit has no place: its impulse is the first number.
      const Vec3 zero = Vec3::Zero();
      recording.contacts.push(time, h, persistent.point.guard, 0, 2, step_, zero, zero, out.start, out.end,
                              out.contact.gap, zero);
      continue;
    }
    const Vec3 middle = 0.5 * (out.contact.point_a + out.contact.point_b);
    const int mode = persistent.mu == 0.0 ? 2 : out.slips || out.slipped ? 1 : 0;
    recording.contacts.push(time, h, persistent.point.guard, persistent.point.feature, mode, step_, middle,
                            out.contact.normal, out.start_W, out.end_W, out.contact.gap, out.slip_W);
  }
}

// Of a step: flights that may be chatter. Elastic contacts bounce on for ever unless something takes energy.
double Simulator::short_flight(double e) const { return e < 1.0 ? kZenoFlight : dissipative_ ? kElasticFlight : 0.0; }

// Closed guards whose impacts accumulate: their next impact is plastic.
void Simulator::find_accumulating(double time) {
  std::fill(plastic_.begin(), plastic_.end(), 0);
  if (!holds()) return;
  const double step = std::min({adaptive_h_, contact_dt(), options_.dt});
  for (int i = 0; i < sequence_.count(); ++i) {
    const ClosedGuard& c = sequence_.closed(i);
    const Bouncing& b = bouncing_[c.guard];
    const double flight = time - b.last_time;
    if ((c.e >= 1.0 && !dissipative_) || c.e == 0.0 || b.hits == 0 || !(flight > 0.0)) continue;
    const bool shorter = b.hits > 1 && flight < b.last_flight;
    const double longest = std::max(b.longest_flight, flight);
    const bool shrinking = c.e < 1.0 && shorter && b.contracting + 1 >= kZenoFlights &&
                           c.e * flight < kZenoFlight * std::min(step, kShortFlight * longest);
    const bool chatter = flight < short_flight(c.e) * step && b.short_hits + 1 >= kShortHits;
    if (shrinking || chatter) plastic_[c.guard] = 1;
  }
}

// Of the contacts just hit, the last flight [s]; 0 if none has flown.
double Simulator::shortest_flight() const {
  double shortest = 0.0;
  for (int g : hit_) {
    const double flight = bouncing_[g].last_flight;
    if (flight > 0.0 && (shortest == 0.0 || flight < shortest)) shortest = flight;
  }
  return shortest;
}

// first: the event's guard; stays: it was closed before. False: the run ends there (DTEC, or as asked).
bool Simulator::judge_accumulation(int first, bool stays, double time, Recording& recording) {
  const double step = std::min({adaptive_h_, contact_dt(), options_.dt});
  bool any = false;
  hit_.clear();
  for (int i = 0; i < sequence_.count(); ++i) {
    const ClosedGuard& c = sequence_.closed(i);
    if (!c.hit) continue;
    any = true;
    hit_.push_back(c.guard);
    Bouncing& b = bouncing_[c.guard];
    const double flight = time - b.last_time;
    if (b.hits > 0 && flight > 0.0) {
      const bool shorter = b.hits > 1 && flight < b.last_flight;
      b.contracting = shorter ? b.contracting + 1 : 0;
      b.short_hits = flight < short_flight(c.e) * step ? b.short_hits + 1 : 0;
      b.longest_flight = std::max(b.longest_flight, flight);
      // Flights shrink geometrically; their measured ratio, not e, is right for articulated bodies too.
      const double ratio = shorter ? flight / b.last_flight : c.e,
                   ends = ratio < 1.0 ? time + flight * ratio / (1.0 - ratio) : time;
      if (plastic_[c.guard] && c.count > 0) note(time, c.points[0], Change::kBouncingEnds, ends, recording);
      if (!holds() && c.e < 1.0 && b.contracting >= kZenoFlights &&
          c.e * flight < kZenoFlight * std::min(adaptive_h_, 0.02 * b.longest_flight)) {
        end(StatusCode::kZeno, time, "impacts accumulate", c.guard);
        status_.accumulation_time = ends;
        return false;
      }
      b.last_flight = flight;
    }
    b.last_time = time;
    ++b.hits;
    if (plastic_[c.guard]) {  // what comes next is another story, unless it comes at once
      const int hits = b.short_hits >= kShortHits ? 1 : 0;
      b = Bouncing();
      b.hits = hits;
      b.last_time = time;
      b.short_hits = hits * (kShortHits - 1);
    }
  }
  if (!any && stays && !holds()) {
    end(StatusCode::kZeno, time, "a contact stays closed", first);
    status_.accumulation_time = time;
    return false;
  }
  return true;
}

}  // namespace contactvi

// Simulator: the set of persistent contacts, from events to steps, the accumulation of impacts, and their records.
#include <algorithm>
#include <cmath>

#include "run/simulator.hpp"

namespace contactvi {

namespace {
constexpr double kZenoFlight = 0.05;     // of a step: bouncing ends where e times the last flight is below it
constexpr double kElasticFlight = 1e-2;  // of a step: as kZenoFlight, for e = 1 where forces dissipate energy
constexpr double kShortFlight = 6e-4;    // of the longest flight: upper limit of the step in these criteria
constexpr int kZenoFlights = 4;          // flights one after the other, each shorter than the one before
constexpr int kChatterFlights = 8;       // flights one after the other below kZenoFlight of a step, shrinking or not
constexpr double kPersists = 1e-11;      // of the speeds: a closed contact with a slower normal speed persists
// Of kPersists: persistent contacts that separate more slowly are left to the step, and pairs with several points,
// whose gaps differ by more, up to the second number.
constexpr double kSlowSeparation = 1e5, kSlowSeparationOfMany = 2e6;
constexpr double kSeparates = 1e-10;  // of the speeds: a persistent contact that separates faster is released
constexpr double kUnloaded = 1e-9;    // of the forces: a smaller one is zero
constexpr double kOpenPair = 1e-9;    // [m] beyond this gap of a pair all its points are released
constexpr double kOpenPoint = 1e-12;  // [m] beyond this gap a contact without load is released

// The contact at a point of a guard; null if there is none.
const PersistentContact* find_contact(const std::vector<PersistentContact>& contacts, int guard,
                                      const ContactPoint& point) {
  for (const PersistentContact& c : contacts)
    if (c.point.guard == guard && c.point.kind == point.kind && c.point.feature == point.feature) return &c;
  return nullptr;
}

}  // namespace

void Simulator::record_change(double time, const ContactPoint& point, Change change, double value,
                              Recording& recording) const {
  recording.changes.push_back({time, point.guard, point.feature, change, value});
}

void Simulator::record_phase(double time, double dt, bool persistent, Recording& recording) const {
  if (!recording.phase_t.empty() && recording.phase_persistent.back() == (persistent ? 1 : 0) &&
      recording.phase_dt.back() == dt)
    return;
  if (recording.phase_t.empty() && !recording.t.empty() && recording.t.front() < time) {
    recording.phase_t.push_back(recording.t.front());
    recording.phase_dt.push_back(truncation_bound_ > 0.0 ? adaptive_dt_ : options_.dt);
    recording.phase_persistent.push_back(0);
  }
  recording.phase_t.push_back(time);
  recording.phase_dt.push_back(dt);
  recording.phase_persistent.push_back(persistent ? 1 : 0);
}

// Tells the guards which of their points are persistent contacts, after a change of the set.
void Simulator::update_persistent_guards() {
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
  contact_step_.invalidate();
}

PersistentContact Simulator::make_persistent(const ContactPoint& point, const Contact& contact, const Vec3& slip) {
  PersistentContact persistent;
  persistent.point = point;
  persistent.mu = scene_->friction(point.guard);
  persistent.tangent = any_tangent(contact.normal);
  if (point.kind == PointKind::kVertex && point.plane_body >= 0)
    persistent.tangent = guards_.placements().R_W[point.plane_body].transpose() * persistent.tangent;
  persistent.slip = slip;
  persistent.sticks = slip.norm() <= kPersists * (1.0 + v_.cwiseAbs().maxCoeff());
  return persistent;
}

// The set of persistent contacts after an event: points that are closed and neither close nor separate, and those of
// the guard `forced` (-1: none).
void Simulator::close_contacts(int forced, double time, const VecX& tau, Recording& recording) {
  guards_.place(q_);
  integrator_.node_velocity(q_, p_, v_);
  const double slow = kPersists * (1.0 + v_.cwiseAbs().maxCoeff());
  previous_contacts_.swap(contact_step_.contacts());
  std::vector<PersistentContact>& now = contact_step_.contacts();
  now.clear();
  for (int i = 0; i < sequence_.count(); ++i) {
    ClosedGuard& c = sequence_.closed(i);
    bool all = true;
    const std::size_t first_of_guard = now.size();
    for (int k = 0; k < c.count; ++k) {
      const double gamma = c.gamma_n(k, p_);
      const std::pair<int, std::int64_t> key(c.guard, c.points[k].feature);
      const auto separated = std::find(separated_.begin(), separated_.end(), key);
      if (separated != separated_.end()) {
        if (!c.impacted && c.guard != forced) {
          all = false;  // has just separated and has not closed again
          continue;
        }
        separated_.erase(separated);
      }
      double slow_separation = slow * (c.count > 1 ? kSlowSeparationOfMany : c.persistent ? kSlowSeparation : 0.0);
      // Contacts that release each other without progress all persist.
      if (c.persistent && changes_without_progress_ >= kStandstill) slow_separation = INFINITY;
      if (std::abs(gamma) > slow && c.guard != forced && !(gamma > 0.0 && gamma < slow_separation)) {
        all = false;
        continue;
      }
      Vec3 slip = Vec3::Zero();
      if (c.mu > 0.0) {
        const int r = 3 * k;
        slip = c.speed(r + 1, p_) * c.t1[k] + c.speed(r + 2, p_) * c.contacts[k].normal.cross(c.t1[k]);
      }
      PersistentContact persistent = make_persistent(c.points[k], c.contacts[k], slip);
      const PersistentContact* before = find_contact(previous_contacts_, c.guard, c.points[k]);
      if (before != nullptr) {
        persistent.tangent = before->tangent;
        if (persistent.sticks && before->anchored && !c.impacted) {
          persistent.anchored = true;
          persistent.anchor = before->anchor;
        }
      } else {
        persistent.is_new = true;
      }
      now.push_back(persistent);
    }
    // If all points of a face persist, those that span it are enough.
    if (all && c.chosen < c.count && c.chosen > 2) now.resize(first_of_guard + c.chosen);
    if (all && c.count > 0) finder_.set_touching(c.guard, false);
  }
  release_unloaded(forced, tau);
  for (const PersistentContact& persistent : now)
    if (persistent.is_new) record_change(time, persistent.point, Change::kBegin, 0.0, recording);
  for (PersistentContact& persistent : now) persistent.is_new = false;
  for (const PersistentContact& old : previous_contacts_) {
    bool stays = false;
    for (const PersistentContact& persistent : now)
      stays |= persistent.point.guard == old.point.guard && persistent.point.feature == old.point.feature;
    if (!stays) record_change(time, old.point, Change::kRelease, 0.0, recording);
  }
  update_persistent_guards();
}

// New contacts that no force presses together do not persist: their guards stay touching, and the steps stay smooth.
void Simulator::release_unloaded(int forced, const VecX& tau) {
  std::vector<PersistentContact>& now = contact_step_.contacts();
  bool any = false;
  for (const PersistentContact& persistent : now) any |= persistent.is_new && persistent.point.guard != forced;
  if (!any) return;
  update_persistent_guards();
  if (!contact_step_.persistent_forces_at(q_, p_, tau, forces_)) return;
  const double scale = contact_step_.force_scale();
  for (int i = static_cast<int>(now.size()) - 1; i >= 0; --i) {
    if (!now[i].is_new || now[i].point.guard == forced || forces_[i] > kUnloaded * scale) continue;
    finder_.set_touching(now[i].point.guard, true);
    now.erase(now.begin() + i);
  }
}

// The persistent contacts at the start of a run: guards that touch and do not separate.
void Simulator::close_contacts_at_start() {
  std::vector<int> touching;
  for (int g : meeting_guards_)
    if (finder_.touching(g)) touching.push_back(g);
  if (touching.empty() || !sequence_.collect(q_, p_, time_, touching, -1, {})) return;
  Recording start;
  close_contacts(-1, time_, VecX(), start);
  initial_changes_ = start.changes;
}

// Releases the contacts that have separated in the contact step just accepted, and records it.
void Simulator::release_separated(double time, Recording& recording) {
  std::vector<PersistentContact>& contacts = contact_step_.contacts();
  const std::vector<ContactOutcome>& outcomes = contact_step_.outcomes();
  const double fast = kSeparates * (1.0 + contact_step_.end_velocity().cwiseAbs().maxCoeff());
  bool dropped = false;
  for (int i = static_cast<int>(contacts.size()) - 1; i >= 0; --i) {
    const ContactOutcome& out = outcomes[i];
    const double apart =
        guards_.is_noisy(contacts[i].point.guard) ? guards_.root_tolerance(contacts[i].point.guard) : kOpenPoint;
    const bool leaves =
        i == releasing_ || (out.position_impulse[0] <= 0.0 && out.contact.gap > apart) || out.w_n > fast;
    if (!leaves) continue;
    const ContactPoint point = contacts[i].point;
    record_change(time, point, Change::kRelease, 0.0, recording);
    contacts.erase(contacts.begin() + i);
    finder_.set_touching(point.guard, true);
    separated_.emplace_back(point.guard, point.feature);
    if (i == releasing_) finder_.exempt(point.guard);
    dropped = true;
  }
  releasing_ = -1;
  if (dropped) update_persistent_guards();
}

// Whether the points of a guard have to be found again. Against a halfspace they stay the same while they are valid.
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

// Releases all points of a guard.
void Simulator::release_guard(int guard, double time, Recording& recording) {
  std::vector<PersistentContact>& contacts = contact_step_.contacts();
  for (int i = static_cast<int>(contacts.size()) - 1; i >= 0; --i) {
    if (contacts[i].point.guard != guard) continue;
    record_change(time, contacts[i].point, Change::kRelease, 0.0, recording);
    contacts.erase(contacts.begin() + i);
  }
  finder_.set_touching(guard, false);
  update_persistent_guards();
}

// Finds the contact points again at a node, because those of faces change as bodies slide on each other. Points that
// have closed meanwhile and approach have an impact. False: the run has ended.
bool Simulator::update_contact_points(const Interval& interval, Recording& recording) {
  bool changed = false;
  int first = -1;
  for (PersistentContact& persistent : contact_step_.contacts()) {
    if (persistent.point.kind != PointKind::kRim) continue;
    guards_.place(q_);
    guards_.manifolds().update_rim(persistent.point, guards_.placements());
  }
  for (int g : persistent_guards_) {
    if (!scene_->is_pair(g) || !points_may_change(g)) continue;
    guards_.place(q_);
    Contact witness;
    const double gap = guards_.evaluate_witness(g, witness), margin = std::max(guards_.touch_tolerance(g), gap);
    if (gap > std::max(guards_.touch_tolerance(g), kOpenPair)) {
      lost_guards_.push_back(g);  // its points slid over an edge in the last step
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
  for (int g : lost_guards_) release_guard(g, interval.start + interval.done, recording);
  lost_guards_.clear();
  if (!changed) return true;
  // As at an event, points that close have an impact, and those that neither close nor separate persist.
  const std::vector<int> none(persistent_guards_);
  if (!sequence_.collect(q_, p_, interval.start + interval.done, none, first, {}))
    return end(sequence_.code(), interval.start + interval.done, sequence_.message());
  const Instant now{interval.start + interval.done, 0.0, interval.remaining, interval.tau, step_};
  const double slow = kSeparates * (1.0 + contact_step_.end_velocity().cwiseAbs().maxCoeff());
  double worst = 0.0;
  for (int i = 0; i < sequence_.count(); ++i) worst = std::min(worst, sequence_.closed(i).gamma_n(p_));
  if (worst < -slow) {
    find_accumulating_impacts(now.time);
    if (!run_impacts(now, recording)) return end(sequence_.code(), now.time, sequence_.message(), sequence_.guard());
  }
  close_contacts(-1, now.time, interval.tau, recording);
  return true;
}

void Simulator::record_contact_forces(double time, double h, Recording& recording) {
  const std::vector<ContactOutcome>& outcomes = contact_step_.outcomes();
  const double force_share = 10.0;  // of the force in the step before: a larger one is an impact without collision
  for (std::size_t i = 0; i < outcomes.size(); ++i) {
    const PersistentContact& persistent = contact_step_.contacts()[i];
    const ContactOutcome& out = outcomes[i];
    const double now = time + h;
    if (persistent.mu > 0.0 && persistent.sticks != !out.slips)
      record_change(now, persistent.point, out.slips ? Change::kSlip : Change::kStick, 0.0, recording);
    // An impulse that does not go to zero with the step is the impact without collision of Painleve's paradox.
    const double sudden = (out.position_impulse[0] + out.velocity_impulse[0]) / h;
    const bool jumps = persistent.force[0] > 0.0 && !persistent.sticks && out.paradox < 1.0 &&
                       sudden > force_share * persistent.force[0];
    if (persistent.mu > 0.0 && (out.paradox <= 0.0 || jumps))
      record_change(time, persistent.point, Change::kInconsistent, out.paradox, recording);
    if (!options_.record_contacts) continue;
    if (!scene_->is_pair(persistent.point.guard)) {
      // A joint limit has no contact point: its impulse is the first of the three numbers.
      const Vec3 zero = Vec3::Zero();
      recording.contacts.push(time, h, persistent.point.guard, 0, ContactMode::kFrictionless, step_, zero, zero,
                              out.position_impulse, out.velocity_impulse, out.contact.gap, zero);
      continue;
    }
    const Vec3 middle = 0.5 * (out.contact.point_a + out.contact.point_b);
    const ContactMode mode = persistent.mu == 0.0       ? ContactMode::kFrictionless
                             : out.slips || out.slipped ? ContactMode::kSlips
                                                        : ContactMode::kSticks;
    recording.contacts.push(time, h, persistent.point.guard, persistent.point.feature, mode, step_, middle,
                            out.contact.normal, out.position_impulse_W, out.velocity_impulse_W, out.contact.gap,
                            out.slip_W);
  }
}

// Flights shorter than this part of a step may be chatter. Elastic contacts bounce for ever unless forces dissipate
// energy.
double Simulator::short_flight_limit(double e) const {
  return e < 1.0 ? kZenoFlight : dissipative_ ? kElasticFlight : 0.0;
}

// Finds the closed guards whose impacts accumulate: their impacts at this event are plastic.
void Simulator::find_accumulating_impacts(double time) {
  std::fill(plastic_.begin(), plastic_.end(), 0);
  if (!allows_persistent_contact()) return;
  const double step = std::min({adaptive_dt_, contact_dt(), options_.dt});
  for (int i = 0; i < sequence_.count(); ++i) {
    const ClosedGuard& c = sequence_.closed(i);
    const Bouncing& b = bouncing_[c.guard];
    const double flight = time - b.last_time;
    if ((c.e >= 1.0 && !dissipative_) || c.e == 0.0 || b.impacts == 0 || !(flight > 0.0)) continue;
    const bool shorter = b.impacts > 1 && flight < b.last_flight;
    const double longest = std::max(b.longest_flight, flight);
    const bool shrinking = c.e < 1.0 && shorter && b.shrinking_flights + 1 >= kZenoFlights &&
                           c.e * flight < kZenoFlight * std::min(step, kShortFlight * longest);
    const bool chatter = flight < short_flight_limit(c.e) * step && b.short_flights + 1 >= kChatterFlights;
    if (shrinking || chatter) plastic_[c.guard] = 1;
  }
}

// Shortest of the last flights of the guards that had an impact at this event [s]; 0 if there was none.
double Simulator::shortest_flight() const {
  double shortest = 0.0;
  for (int g : impacted_guards_) {
    const double flight = bouncing_[g].last_flight;
    if (flight > 0.0 && (shortest == 0.0 || flight < shortest)) shortest = flight;
  }
  return shortest;
}

// Counts the flights of the guards that had an impact. first: guard of the event; stays: it was closed before the
// event. False: impacts accumulate and the run ends, as its options ask or because its map allows no persistent
// contact.
bool Simulator::update_bouncing(int first, bool stays, double time, Recording& recording) {
  const double step = std::min({adaptive_dt_, contact_dt(), options_.dt});
  bool any = false;
  impacted_guards_.clear();
  for (int i = 0; i < sequence_.count(); ++i) {
    const ClosedGuard& c = sequence_.closed(i);
    if (!c.impacted) continue;
    any = true;
    impacted_guards_.push_back(c.guard);
    Bouncing& b = bouncing_[c.guard];
    const double flight = time - b.last_time;
    if (b.impacts > 0 && flight > 0.0) {
      const bool shorter = b.impacts > 1 && flight < b.last_flight;
      b.shrinking_flights = shorter ? b.shrinking_flights + 1 : 0;
      b.short_flights = flight < short_flight_limit(c.e) * step ? b.short_flights + 1 : 0;
      b.longest_flight = std::max(b.longest_flight, flight);
      // Flights shrink geometrically. Their measured ratio is right for articulated bodies too, while e is not.
      const double ratio = shorter ? flight / b.last_flight : c.e,
                   ends = ratio < 1.0 ? time + flight * ratio / (1.0 - ratio) : time;
      if (plastic_[c.guard] && c.count > 0) record_change(time, c.points[0], Change::kBouncingEnds, ends, recording);
      if (!allows_persistent_contact() && c.e < 1.0 && b.shrinking_flights >= kZenoFlights &&
          c.e * flight < kZenoFlight * std::min(adaptive_dt_, 0.02 * b.longest_flight)) {
        end(StatusCode::kZeno, time, "impacts accumulate", c.guard);
        status_.accumulation_time = ends;
        return false;
      }
      b.last_flight = flight;
    }
    b.last_time = time;
    ++b.impacts;
    if (plastic_[c.guard]) {  // the count starts again, unless the next flights are short at once
      const int hits = b.short_flights >= kChatterFlights ? 1 : 0;
      b = Bouncing();
      b.impacts = hits;
      b.last_time = time;
      b.short_flights = hits * (kChatterFlights - 1);
    }
  }
  if (!any && stays && !allows_persistent_contact()) {
    end(StatusCode::kZeno, time, "a contact stays closed", first);
    status_.accumulation_time = time;
    return false;
  }
  return true;
}

}  // namespace contactvi

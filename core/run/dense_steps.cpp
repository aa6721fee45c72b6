// Simulator: dense steps, and the decision between them and located events.
//
// Events are given up where they accumulate: too many impacts at instants with several
// closed contacts, too many changes of the persistent contacts, too many parts of steps; and where the run would end
// because an event or the forces of persistent contacts are not found. They are located again after a number of quiet
// steps, which doubles each time that they accumulate again soon.
#include "run/dense_phase.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "run/simulator.hpp"

namespace contactvi {

namespace {
// Limits of what may have happened to an island lately, for intervals of a millisecond; longer ones have them in
// proportion. They bound the time that a step takes, and lie twice above what a grasp needs
// (tests/simulation/test_hand_scene.py).
constexpr double kCounted = 1e-3;                                 // [s]
constexpr double kMemory = 5e-2;                                  // [s] after which half of a count is forgotten
constexpr double kCoupledImpacts = 1024, kImpactsPerContact = 8;  // impacts at instants with several closed contacts
constexpr double kChanges = 3072, kChangesPerContact = 4;         // begins and releases of persistent contacts
constexpr double kContactParts = 1024;  // steps with persistent contacts beyond those asked for
constexpr double kRescues = 2000;  // sum of the squares of the rows of contact problems in which slow methods are tried
// Larger islands have lower limits, as the square of their degrees of freedom: an event costs that much more there.
constexpr double kSmall = 24;
constexpr int kContactHalvings = 30;  // of steps with persistent contacts that were not solved
// Rows of the persistent contacts (24 points with friction): with more of them the dense step, of the same order
// without impacts, is far cheaper, since the matrix of the contact step is full.
constexpr int kMostPersistent = 72;
constexpr double kRestIsRounding = 1e-9;       // of what is left of a step: a shorter rest is no step of its own
constexpr double kShortestPromise = 1.0 / 64;  // of a step: no shorter one is tried for the sake of gaps and energy
constexpr double kSlow = 1e-11;                // of the speeds: a slower slip is rounding
constexpr double kShortestDense = 1e-6;        // of a step: dense steps are halved down to this length
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// What the limits are multiplied by in an interval of this length [s].
double times(double length) { return std::max(1.0, length / kCounted); }

}  // namespace

// Whether the run may take dense steps at all.
bool Simulator::allows_dense_steps() const {
  return options_.contact_steps != ContactSteps::kEvents && dense_step_.available() && allows_persistent_contact();
}

int Simulator::persistent_rows() const {
  int rows = 0;
  for (const PersistentContact& c : contact_step_.contacts()) rows += c.rows();
  return rows;
}

// Rows of persistent contacts at most, of a run with located events.
int Simulator::most_persistent() const {
  return allows_dense_steps() ? kMostPersistent : std::numeric_limits<int>::max();
}

// How much slow methods may be tried in the contact problems of an interval: the sum of the squares of their rows.
double Simulator::most_rescues(double length) const {
  return allows_dense_steps() ? times(length) * kRescues : std::numeric_limits<double>::infinity();
}

bool Simulator::events_accumulate(double length) const {
  if (contact_step_.contacts().empty() && state_.dense.events.none()) return contact_step_.gave_up();
  const double contacts =
      static_cast<double>(std::max<std::size_t>(contact_step_.contacts().size(), sequence_.count()));
  const double small = std::min(1.0, kSmall / std::max(1, scene_->tree.nv));
  // With adaptive steps a smooth step, in which events begin to accumulate, says nothing about how many there may be.
  const double more = times(truncation_.bound > 0.0 ? std::min(length, contact_dt()) : length) * small * small;
  const EventCount& count = state_.dense.events;
  return count.coupled_impacts > more * (kCoupledImpacts + kImpactsPerContact * contacts) ||
         count.changes > more * (kChanges + kChangesPerContact * contacts) ||
         count.contact_parts > more * kContactParts || count.contact_halvings > kContactHalvings ||
         contact_step_.gave_up() || persistent_rows() > most_persistent();
}

// Whether a run that has ended so goes on with dense steps.
bool Simulator::dense_steps_go_on() const {
  switch (state_.status.code) {
    case StatusCode::kNewtonFailed:
    case StatusCode::kEventUnresolved:
    case StatusCode::kTooManyImpacts:
    case StatusCode::kNotFinite:  // an impact was not solved; a state that is not finite ends the run
      return state_.q.allFinite() && state_.p.allFinite() && !scene_->tree.elements.user_failed();
    default:
      return false;
  }
}

void Simulator::begin_dense_phase() {
  state_.status = {StatusCode::kSuccess, "", state_.time, -1, kNaN, kNaN};
  if (state_.dense.active) return;
  state_.dense.begin();
  dense_step_.restart();
  guards_.forget_distances();
  integrator_.forget();
}

void EventCount::fade(double length) {
  const double left = 1.0 / (1.0 + length / kMemory);
  coupled_impacts *= left;
  changes *= left;
  contact_parts *= left;
  contact_halvings = 0;
}

void EventCount::join(const EventCount& other) {
  coupled_impacts = std::max(coupled_impacts, other.coupled_impacts);
  changes = std::max(changes, other.changes);
  contact_parts = std::max(contact_parts, other.contact_parts);
}

void DensePhase::begin() {
  events = EventCount();
  const bool soon = wanted > 0 && since_return < kSoon * static_cast<long>(wanted);
  wanted = soon ? std::min(2 * wanted, kMostQuietSteps) : kQuietSteps;
  active = true;
  quiet = 0;
  longest = 0.0;
}

// Whether events may be located again: some steps were quiet, and the contacts are so few that their step is cheap.
bool Simulator::dense_may_end() const { return may_leave_dense_steps() && state_.dense.quiet >= state_.dense.wanted; }

bool Simulator::may_leave_dense_steps() const {
  return state_.dense.active && options_.contact_steps == ContactSteps::kAuto && persistent_rows() <= most_persistent();
}

// Events are located again: what the last dense step has left closed persists.
void Simulator::end_dense_phase() {
  state_.dense.active = false;
  state_.dense.since_return = 0;
  state_.separated.clear();
  guards_.forget_distances();
  integrator_.forget();
  finder_.forget_touching();
  for (int guard : dense_step_.memory().closed) finder_.set_touching(guard, true);
  for (const PersistentContact& c : contact_step_.contacts()) finder_.set_touching(c.point.guard, false);
  finder_.cut();
  contacts_.update_persistent_guards();
  const long halved = state_.control.halved;
  state_.control.start(options_.dt, contact_dt());
  state_.control.halved = halved;
  if (contact_step_.empty()) resume_free_motion();
}

// One dense step, of the length of steps with persistent contacts where it can be solved and keeps its promises.
bool Simulator::advance_dense(Interval& interval, Recording& recording) {
  const double at = interval.start + interval.done, nominal = contact_dt();
  dense_step_.set_time(at);
  dense_step_.set_nominal(nominal);
  // A rest that is rounding is taken along: gaps of rounding, closed in its time, would be speeds of metres per second.
  const double longest = state_.dense.longest;
  const double parts = interval.parts(nominal), whole = interval.remaining / parts;
  const bool shorter = longest > 0.0 && longest < whole * (1.0 - kRestIsRounding);
  double h = shorter ? longest : whole, share = shorter ? 0.0 : 1.0 / parts;
  for (;;) {
    bool solved = dense_step_.solve(state_.q, state_.p, h, interval.tau);
    while (solved && actuation_.saturate_servos(dense_step_.integrator()))
      solved = dense_step_.solve(state_.q, state_.p, h, interval.tau);
    // Where gaps or energy are not what the step promises a shorter one is nearer to them; the shortest is taken as it
    // is, or with what gaps are left where the energy would rise.
    const bool shortest = h <= kShortestPromise * nominal;
    if (solved && shortest && dense_step_.report().energy_rise > 0.0)
      solved = dense_step_.solve(state_.q, state_.p, h, interval.tau, DenseStep::Kept::kEnergy);
    if (solved && (shortest || dense_step_.keeps_promises())) break;
    if (user_function_failed(at)) return false;
    h *= 0.5;
    share *= 0.5;
    ++state_.control.halved;
    if (h < kShortestDense * nominal)
      return end(StatusCode::kNewtonFailed, at, std::string("a dense step was not solved: ") + dense_step_.why());
  }
  dense_step_.finish(q1_, p1_);
  if (!stays_in_range(at)) return false;
  state_.dense.longest = 2.0 * h < nominal ? 2.0 * h : 0.0;
  record_phase(at, nominal, StepKind::kDense, recording);
  if (options_.gradient) keep_dense_step(at, share);
  accept_dense_step(at, h, recording);
  interval.done += h;
  interval.remaining = h >= interval.remaining * (1.0 - 1e-12) ? 0.0 : interval.length - interval.done;
  return true;
}

// Keeps the dense step just solved. share: its length of what was left of the control step; 0: it does not depend on
// that.
void Simulator::keep_dense_step(double time, double share) {
  DenseStepRecord record = dense_step_.record();
  record.t = time;
  record.share = share;
  record.allowed_rate = dense_step_.allowed_rate();
  kept_dense_steps_.push_back(std::move(record));
}

void Simulator::accept_dense_step(double time, double h, Recording& recording) {
  state_.work.add(dense_step_);
  if (options_.record_contacts)
    for (const DenseContact& c : dense_step_.contacts())
      if (c.loaded()) record_dense_contact(c, time, h, recording);
  const bool changed = contacts_.follow(dense_step_, time + h, recording);
  const DenseReport& report = dense_step_.report();
  const int deepest = dense_step_.deepest();
  if (deepest >= 0 && scene_->is_pair(deepest) && report.gap < -guards_.promised(deepest))
    record_overlap(deepest, report.gap, time + h, recording);
  recording.dense.push_back({time, h, report.residual, report.gap, report.energy_rise, report.energy_loss,
                             report.energy_error, report.contacts, report.repaired, state_.step, 0});
  dense_step_.commit();
  if (options_.dense) {
    rates_.colwise() = dense_step_.stage_velocity();
    record_segment(time, h, p1_, recording);
    recording.segments.persistent.back() = 1.0;
  }
  state_.q = q1_;
  state_.p = p1_;
  state_.dense.quiet = changed ? 0 : state_.dense.quiet + 1;
  ++state_.dense_steps;
}

void Simulator::record_dense_contact(const DenseContact& c, double time, double h, Recording& recording) const {
  if (!scene_->is_pair(c.point.guard)) {
    const Vec3 zero = Vec3::Zero();
    recording.contacts.push(time, h, c.point.guard, 0, ContactMode::kFrictionless, state_.step, zero, zero, c.position,
                            c.velocity, c.at1.gap, zero);
    recording.contacts.dense.back() = 1;
    return;
  }
  const double slow = kSlow * (1.0 + dense_step_.end_velocity().cwiseAbs().maxCoeff());
  const ContactMode mode = c.mu == 0.0           ? ContactMode::kFrictionless
                           : c.slip_speed > slow ? ContactMode::kSlips
                                                 : ContactMode::kSticks;
  recording.contacts.push(time, h, c.point.guard, c.point.feature, mode, state_.step,
                          0.5 * (c.at1.point_a + c.at1.point_b), c.at1.normal, c.position_W(), c.velocity_W(),
                          c.at1.gap, c.slip_W);
  recording.contacts.dense.back() = 1;
}

}  // namespace contactvi

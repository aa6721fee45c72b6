// Simulator: dense steps, and the decision between them and located events.
//
// Events are given up where locating them costs more than dense steps by far, and where the run would end because an
// event or the forces of persistent contacts are not found. They are located again after a number of quiet steps, which
// doubles each time that they accumulate again soon.
#include "run/dense_phase.hpp"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "run/simulator.hpp"

namespace contactvi {

namespace {
// Locating events may cost as many times what dense steps of the same length cost: it tells more about the motion.
constexpr double kDearer = 3.0;
// A step to which nothing happens may cost more: what stays at rest with located events is not solved any more.
constexpr double kQuietDearer = 5.0;
// [us] of bursts besides, of contacts with up to so many modes; those of a grasp by three fingers reach 1.2e5
// (test_hand_scene.py). Runs that choose their steps for an accuracy may spend it once per stage, each of which has its
// own distances.
constexpr double kBurst = 1.5e5, kFewModes = 27.0;
// A point is open or closed; with friction it is open, sticks or slides.
constexpr double kModes = 2.0, kModesOfFriction = 3.0;
constexpr double kCounted = 1e-3;  // [s] length of the dense steps that count, unless those of contact are shorter
constexpr double kRestIsRounding = 1e-9;       // of what is left of a step: a shorter rest is no step of its own
constexpr double kShortestPromise = 1.0 / 64;  // of a step: no shorter one is tried for the sake of gaps and energy
constexpr double kSlow = 1e-11;                // of the speeds: a slower slip is rounding
constexpr double kShortestDense = 1e-6;        // of a step: dense steps are halved down to this length

// Of two bodies so many points count, the others move with them: a box that slides over seams on a dozen of them is no
// heap (test_drawn_seams.py).
constexpr int kPointsOfBodies = 3;

// The modes of contacts that are added one by one.
class ModeCount {
 public:
  explicit ModeCount(const Scene& scene) : scene_(scene) {}

  void add(int guard, double mu) {
    if (scene_.is_pair(guard)) {
      const Pair& pair = scene_.pairs[guard];
      const int a = scene_.geometries[pair.a].body, b = scene_.geometries[pair.b].body;
      seen_.emplace_back(std::min(a, b), std::max(a, b));
      if (std::count(seen_.begin(), seen_.end(), seen_.back()) > kPointsOfBodies) return;
    }
    modes_ *= mu > 0.0 ? kModesOfFriction : kModes;
  }
  double modes() const { return modes_; }

 private:
  const Scene& scene_;
  std::vector<std::pair<int, int>> seen_;
  double modes_ = 1.0;
};

}  // namespace

// Whether the run may take dense steps at all.
bool Simulator::allows_dense_steps() const {
  return options_.contact_steps != ContactSteps::kEvents && allows_persistent_contact();
}

// What locating events has cost so far [us].
double Simulator::located_cost() const {
  return contact_step_.counters.cost + guards_.counters.cost + costs_.impact() * static_cast<double>(state_.impacts) +
         costs_.stage_iteration() * static_cast<double>(integrator_.counters.stage_iterations);
}

// Whether contacts with so many rows and points are worth steps with events, if nothing happens to them.
bool Simulator::locating_pays(int rows, int points) const {
  return !allows_dense_steps() || costs_.quiet_contact_step(rows) <= kQuietDearer * costs_.dense_step(points);
}

// The points of contact of the present instant.
double Simulator::points_now() const {
  return static_cast<double>(std::max<std::size_t>(contact_step_.contacts().size(), sequence_.count()));
}

// The share of a burst that contacts with so many modes as those of the present instant may cost: what locating them
// tells is one of these modes, and worth the less the more there are that the same scene but for rounding might have
// taken.
double Simulator::share_of_burst() const {
  ModeCount persistent(*scene_), closed(*scene_);
  for (const PersistentContact& c : contact_step_.contacts()) persistent.add(c.point.guard, c.mu);
  for (int i = 0; i < sequence_.count(); ++i) closed.add(sequence_.closed(i).guard, sequence_.closed(i).mu);
  return std::min(1.0, kFewModes / std::max(persistent.modes(), closed.modes()));
}

// What locating events may cost in an interval of this length [us].
double Simulator::allowed_cost(double length) const {
  return kDearer * length / std::min(contact_dt(), kCounted) * costs_.dense_step(points_now());
}

// Whether it has cost more than dense steps by far.
bool Simulator::events_accumulate(double cost, double length) const {
  const double beyond = state_.dense.located.excess + cost - allowed_cost(length);
  if (!(state_.dense.located.excess + cost > 0.0 && beyond > 0.0)) return false;
  const double burst = truncation_.bound > 0.0 ? kBurst * options_.stages : kBurst;
  // A phase of dense steps is some of them long: what costs less than those is not worth one.
  const double phase = DensePhase::kQuietSteps * costs_.dense_step(points_now());
  return beyond > std::max(burst * share_of_burst(), phase);
}

// Whether a run that has ended so goes on with dense steps.
bool Simulator::dense_steps_go_on() const {
  switch (state_.status.code) {
    case StatusCode::kNewtonFailed:
    case StatusCode::kEventUnresolved:
    case StatusCode::kTooManyImpacts:
    case StatusCode::kImpactUnsolved:
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
  // A joint that sticks may move in dense steps, and stick elsewhere.
  for (auto& joint : contact_step_.friction_joints()) joint.anchored = false;
  guards_.forget_distances();
  integrator_.forget();
}

void DensePhase::begin() {
  const bool soon = wanted > 0 && since_return < kSoon * static_cast<long>(wanted);
  wanted = soon ? std::min(2 * wanted, kMostQuietSteps) : kQuietSteps;
  active = true;
  quiet = 0;
  longest = 0.0;
}

// Whether events may be located again: some steps were quiet, and the contacts are so few that their step is cheap.
bool Simulator::dense_may_end() const {
  return options_.contact_steps == ContactSteps::kAuto && state_.dense.quiet >= state_.dense.wanted &&
         persistent_contacts_pay();
}

bool Simulator::persistent_contacts_pay() const {
  int rows = 0;
  for (const PersistentContact& c : contact_step_.contacts()) rows += c.rows();
  return locating_pays(rows, static_cast<int>(contact_step_.contacts().size()));
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
  finder_.forget_step();
  contacts_.update_persistent_guards();
  const long halved = state_.control.halved;
  state_.control.start(options_.dt, contact_dt());
  if (truncation_.bound > 0.0) state_.control.free.longest = truncation_.length;  // the step of run_auto stays
  state_.control.halved = halved;
  if (contact_step_.contacts().empty()) resume_free_motion(state_.time);
}

// One dense step, of the length of steps with persistent contacts where it can be solved and keeps its promises.
bool Simulator::advance_dense(Interval& interval, Recording& recording) {
  const double at = interval.start + interval.done, nominal = contact_dt();
  contacts_.forget_persistent_guards();
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
    if (solved && !dense_step_.passes_through() && (shortest || dense_step_.keeps_promises())) break;
    if (user_function_failed(at)) return false;
    if (shortest && dense_step_.violated_constraint() >= 0) return end_violated(dense_step_.violated_constraint(), at);
    h *= 0.5;
    share *= 0.5;
    ++state_.control.halved;
    if (h < kShortestDense * nominal)
      return end(StatusCode::kNewtonFailed, at,
                 dense_step_.passes_through() ? "bodies would pass through each other in the shortest dense step"
                                              : std::string("a dense step was not solved: ") + dense_step_.why());
  }
  const int deepest = dense_step_.deepest();
  if (scene_->tree.elements.driven() && deepest >= 0 && dense_step_.report().gap < -guards_.promised(deepest))
    return end(StatusCode::kConstraint, at, "what the constraints drive leaves this contact no way out", deepest);
  dense_step_.finish(q1_, p1_);
  if (!stays_in_range(at)) return false;
  // A rest that was solved whole says nothing of longer ones. Lengths by powers of two do not move with its start.
  if (shorter || h < whole) {
    const double next = 2.0 * step_length_within(h, nominal);
    state_.dense.longest = next < nominal ? next : 0.0;
  }
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
    recording.contacts.push_back({time, h, c.point.guard, 0, ContactMode::kFrictionless, state_.step, zero, zero,
                                  c.position, c.velocity, c.at1.gap, zero, 0.0, true});
    return;
  }
  const double slow = kSlow * (1.0 + dense_step_.end_velocity().cwiseAbs().maxCoeff());
  const ContactMode mode = c.mu == 0.0           ? ContactMode::kFrictionless
                           : c.slip_speed > slow ? ContactMode::kSlips
                                                 : ContactMode::kSticks;
  recording.contacts.push_back({time, h, c.point.guard, c.point.feature, mode, state_.step,
                                0.5 * (c.at1.point_a + c.at1.point_b), c.at1.normal,
                                c.position_W() - c.pull[0] * c.at0.normal, c.velocity_W() - c.pull[1] * c.at1.normal,
                                c.at1.gap, c.slip_W, 0.0, true});
}

}  // namespace contactvi

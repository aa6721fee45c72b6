// Simulator: dense steps, and the decision between them and located events.
//
// Events are given up for the rest of an interval where they accumulate: too many impacts at instants with several closed
// contacts, too many changes of the persistent contacts, too many parts of steps; and where the run would end because an
// event or the forces of persistent contacts are not found. They are located again after a number of quiet steps, which
// doubles each time that they accumulate again soon.
#include "run/dense_phase.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "run/simulator.hpp"

namespace contactvi {

namespace {
constexpr long kCoupledImpacts = 64;  // in an interval, and so many more per closed contact:
constexpr long kImpactsPerContact = 8;
constexpr int kChanges = 16;             // of the persistent contacts in an interval, and so many more per contact:
constexpr int kChangesPerContact = 4;
constexpr int kContactParts = 64;        // of steps with persistent contacts in an interval
constexpr int kQuietSteps = 8, kMostQuietSteps = 1024;
constexpr int kSoon = 8;                 // times the quiet steps wanted: events that accumulate again so soon
constexpr std::size_t kMostPersistent = 16;  // points: beyond them the dense step is as accurate and cheaper
constexpr double kShortestDense = 1e-6;  // of a step: dense steps are halved down to this length
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
}  // namespace

// Whether the run may take dense steps at all.
bool Simulator::allows_dense_steps() const {
  return options_.contact_steps != ContactSteps::kEvents && dense_step_.available() && truncation_bound_ == 0.0 &&
         allows_persistent_contact();
}

bool Simulator::events_accumulate() const {
  const long contacts = static_cast<long>(std::max<std::size_t>(contact_step_.contacts().size(), sequence_.count()));
  return event_count_.coupled_impacts > kCoupledImpacts + kImpactsPerContact * contacts ||
         event_count_.changes > kChanges + kChangesPerContact * contacts || event_count_.contact_parts > kContactParts;
}

// Whether a run that has ended so goes on with dense steps.
bool Simulator::dense_steps_go_on() const {
  switch (status_.code) {
    case StatusCode::kNewtonFailed:
    case StatusCode::kEventUnresolved:
    case StatusCode::kTooManyImpacts:
      return q_.allFinite() && p_.allFinite() && !scene_->tree.elements.user_failed();
    default:
      return false;
  }
}

void Simulator::begin_dense_phase() {
  status_ = {StatusCode::kSuccess, "", time_, -1, kNaN, kNaN};
  if (dense_phase_.active) return;
  const bool soon = dense_phase_.since_return < kSoon * static_cast<long>(dense_phase_.wanted);
  dense_phase_.wanted = soon && dense_phase_.since_return > 0 ? std::min(2 * dense_phase_.wanted, kMostQuietSteps)
                                                              : kQuietSteps;
  dense_phase_.active = true;
  dense_phase_.quiet = 0;
  dense_step_.restart();
  guards_.unmark_all();
  integrator_.forget();
}

// Whether events may be located again: some steps were quiet, and the contacts are so few that their step is cheap.
bool Simulator::dense_may_end() const {
  return options_.contact_steps == ContactSteps::kAuto && dense_phase_.quiet >= dense_phase_.wanted &&
         contact_step_.contacts().size() <= kMostPersistent;
}

// Events are located again: what the last dense step has left closed persists.
void Simulator::end_dense_phase() {
  dense_phase_.active = false;
  dense_phase_.since_return = 0;
  changes_without_progress_ = 0;
  separated_.clear();
  guards_.unmark_all();
  integrator_.forget();
  for (int g = 0; g < guards_.count(); ++g) finder_.set_touching(g, false);
  for (const DenseContact& c : dense_step_.contacts())
    if (c.closed) finder_.set_touching(c.point.guard, true);
  for (const PersistentContact& c : contact_step_.contacts()) finder_.set_touching(c.point.guard, false);
  finder_.cut();
  update_persistent_guards();
  trial_dt_ = options_.dt;
  contact_trial_dt_ = contact_dt();
  flight_dt_ = kinetic_ = 0.0;
  if (contact_step_.empty()) resume_free_motion();
}

// One dense step, to the end of the interval where it can be solved.
bool Simulator::advance_dense(Interval& interval, Recording& recording) {
  const double at = interval.start + interval.done;
  dense_step_.set_time(at);
  double h = interval.remaining;
  for (;;) {
    bool solved = dense_step_.solve(q_, p_, h, interval.tau);
    while (solved && saturate_servos(dense_step_.integrator()))
      solved = dense_step_.solve(q_, p_, h, interval.tau);
    if (solved) break;
    if (user_function_failed(at)) return false;
    h *= 0.5;
    ++halved_;
    if (h < kShortestDense * options_.dt)
      return end(StatusCode::kNewtonFailed, at, std::string("a dense step was not solved: ") + dense_step_.why());
  }
  record_phase(at, options_.dt, StepKind::kDense, recording);
  accept_dense_step(at, h, recording);
  interval.done += h;
  interval.remaining = h >= interval.remaining * (1.0 - 1e-12) ? 0.0 : interval.length - interval.done;
  return true;
}

void Simulator::accept_dense_step(double time, double h, Recording& recording) {
  work_.input += dense_step_.integrator().input_work();
  work_.damping += dense_step_.integrator().damping_loss();
  work_.joint_friction += dense_step_.joint_friction_loss();
  const bool changed = record_dense_contacts(time, h, recording);
  const DenseReport& report = dense_step_.report();
  recording.dense.push_back({time, h, report.residual, report.gap, report.energy_rise, report.energy_loss,
                             report.energy_error, report.contacts, report.repaired, step_});
  dense_step_.commit();
  if (options_.dense) {
    rates_.colwise() = dense_step_.stage_velocity();
    dense_step_.finish(q1_, p1_);
    record_segment(time, h, p1_, recording);
    recording.segments.persistent.back() = 1.0;
  }
  dense_step_.finish(q_, p_);
  dense_phase_.quiet = changed ? 0 : dense_phase_.quiet + 1;
  ++dense_steps_;
}

// Records the contacts of the dense step and makes those that stay closed the persistent ones. True if any began or
// ended or closed fast.
bool Simulator::record_dense_contacts(double time, double h, Recording& recording) {
  guards_.place(dense_step_.end_configuration());
  v_ = dense_step_.end_velocity();
  bool changed = false;
  previous_contacts_.swap(contact_step_.contacts());
  std::vector<PersistentContact>& now = contact_step_.contacts();
  now.clear();
  for (const DenseContact& c : dense_step_.contacts()) {
    changed |= c.expands;
    if (!(c.position[0] + c.velocity[0] > 0.0)) continue;
    if (options_.record_contacts) record_dense_contact(c, time, h, recording);
    if (!c.closed || c.expands) continue;
    PersistentContact persistent = make_persistent(c.point, c.at1, c.slip_W);
    const bool is_vertex = c.point.kind == PointKind::kVertex && c.point.plane_body >= 0;
    persistent.tangent =
        is_vertex ? Vec3(guards_.placements().R_W[c.point.plane_body].transpose() * c.t1_1) : c.t1_1;
    persistent.force = (c.position + c.velocity) / h;
    const bool known = std::any_of(previous_contacts_.begin(), previous_contacts_.end(), [&](const auto& old) {
      return old.point.guard == c.point.guard && old.point.feature == c.point.feature;
    });
    if (!known) {
      record_change(time + h, c.point, Change::kBegin, 0.0, recording);
      changed = true;
    }
    now.push_back(persistent);
  }
  for (const PersistentContact& old : previous_contacts_) {
    const bool stays = std::any_of(now.begin(), now.end(), [&](const auto& c) {
      return old.point.guard == c.point.guard && old.point.feature == c.point.feature;
    });
    if (stays) continue;
    record_change(time + h, old.point, Change::kRelease, 0.0, recording);
    changed = true;
  }
  return changed;
}

void Simulator::record_dense_contact(const DenseContact& c, double time, double h, Recording& recording) const {
  if (!scene_->is_pair(c.point.guard)) {
    const Vec3 zero = Vec3::Zero();
    recording.contacts.push(time, h, c.point.guard, 0, ContactMode::kFrictionless, step_, zero, zero, c.position,
                            c.velocity, c.at1.gap, zero);
    return;
  }
  const double slow = 1e-11 * (1.0 + v_.cwiseAbs().maxCoeff());
  const ContactMode mode = c.mu == 0.0              ? ContactMode::kFrictionless
                           : c.slip_speed > slow ? ContactMode::kSlips
                                                    : ContactMode::kSticks;
  recording.contacts.push(time, h, c.point.guard, c.point.feature, mode, step_,
                          0.5 * (c.at1.point_a + c.at1.point_b), c.at1.normal, c.position_W(), c.velocity_W(), c.at1.gap,
                          c.slip_W);
}

}  // namespace contactvi

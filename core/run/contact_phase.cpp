// Simulator: steps in persistent contact.
//
// A contact step ends early at the first of: an impact of another guard; the release of a contact, where its continuous
// force comes to zero; the transition of a contact from slip to stick. The part up to there is solved again as a
// partial step.
#include <algorithm>
#include <chrono>
#include <cmath>

#include "model/forces.hpp"
#include "run/simulator.hpp"

namespace contactvi {

namespace {
constexpr double kShortestSwing =
    1e-9;  // of a contact step: they are halved down to this where a rim falls nearly flat
constexpr double kShortestRun =
    1.0 / 64;  // of a contact step, where a point runs along lines: a dense step takes what is shorter
constexpr double kDeeper = 1.5;           // of the deepest overlap recorded: a deeper one is recorded
constexpr double kAtStart = 1e-10;        // of a contact step: an event that is earlier is at its start
constexpr double kPhaseRounding = 1e-12;  // of the energies
}  // namespace

bool Simulator::end_violated(int constraint, double time) {
  return end(StatusCode::kConstraint, time,
             "the constraints cannot be met, first " + scene_->tree.elements.constraints[constraint].name);
}

bool Simulator::retry_contact_step(double h, double time) {
  if (user_function_failed(time)) return false;
  const bool runs = contact_step_.rim_turns_far() || contact_step_.runs_along_lines();
  const bool impact = contact_step_.runs_along_lines() && allows_dense_steps() && h <= kShortestRun * contact_dt();
  if (impact)
    return end(StatusCode::kEventUnresolved, time, "a contact runs from end to end of two lines, which is an impact");
  const bool shortest = h < (runs ? kShortestSwing : StepControl::kShortest) * current_dt();
  if (shortest && contact_step_.violated_constraint() >= 0)
    return end_violated(contact_step_.violated_constraint(), time);
  if (shortest)
    return end(StatusCode::kNewtonFailed, time,
               std::string("a step with persistent contacts was not solved: ") +
                   (*contact_step_.why() != 0 ? contact_step_.why() : "an event in it was not located"));
  state_.control.halve_contact(h);
  contact_step_.invalidate();
  return true;
}

// After a contact step of length h was solved: the fraction alpha of it at which it has to end, and whether another
// guard has an impact there (hit). again: the step is to be solved again, with the contacts changed at its start; or
// as one that ends where a contact changes, for a guard closes before that. False: a shorter step has to be tried.
bool Simulator::first_contact_change(const Interval& interval, double h, double& alpha, bool& hit, bool& again,
                                     Recording& recording) {
  alpha = 1.0;
  hit = again = false;
  contact_path_.set(state_.q, h, contact_step_.rates());
  contact_step_.finish(q1_, p1_);
  finder_.set_stepper(contact_step_);
  const Search found = finder_.search(state_.q, state_.p, q1_, p1_, h, interval.tau, contact_path_);
  if (found != Search::kNone && found != Search::kFound) return false;
  if (found == Search::kFound) {
    hit = true;
    alpha = finder_.event().alpha;
    if (alpha * h < kAtStart * contact_dt()) alpha = 0.0;
    if (alpha <= 0.0) return true;
    if (!contact_step_.solve_part(contact_path_, alpha, state_.q, state_.p, interval.tau)) return false;
  } else if (contact_step_.h() != h &&
             !contact_step_.solve_part(contact_path_, 1.0, state_.q, state_.p, interval.tau)) {
    return false;  // solved again, because the search has solved partial steps
  }
  const double limit = alpha;
  bool at_start = false;
  // Where a release or the end of a slip cannot be located the step is accepted as it is: its impulses satisfy the
  // unilateral constraints and the friction cone.
  if (!changes_.find_release(interval.tau, alpha, at_start)) {
    changes_.set_releasing(-1);
    alpha = limit;
    at_start = false;
    if (!contact_step_.solve_part(contact_path_, alpha, state_.q, state_.p, interval.tau)) return false;
  }
  if (at_start) {
    contacts_.release(changes_.releasing(), interval.start + interval.done, interval.tau, recording);
    finder_.cut(0.0);
    again = true;
    return true;
  }
  const bool released = alpha < limit;
  const int releasing = changes_.releasing();
  const double before_stick = alpha;
  if (!changes_.find_stick(interval.tau, alpha)) {
    alpha = before_stick;
    if (!contact_step_.solve_part(contact_path_, alpha, state_.q, state_.p, interval.tau)) return false;
  }
  changes_.set_releasing(released && alpha == before_stick ? releasing : -1);
  if (alpha < limit) {
    hit = false;
    finder_.cut(alpha);
    contact_step_.finish(q1_, p1_);
    guards_.place(q1_);
    if (finder_.closes_before_cut()) {
      state_.control.contact.limit(alpha * h);
      again = true;
    }
  }
  const bool runs = contact_step_.rim_turns_far() || contact_step_.runs_along_lines();
  return alpha <= 0.0 || !runs || h <= kShortestSwing * contact_dt();
}

// Whether the energy changes in the contact step just solved by more than friction and its error explain: then it is
// rejected. Contacts cannot do positive work, but a step in which a contact point jumps from one feature of a shape to
// another, or runs far along two lines, may show such changes.
bool Simulator::changes_energy() {
  contact_step_.finish(q1_, p1_);
  const double T0 = 0.5 * state_.p.dot(contact_step_.start_velocity()), V0 = potential(state_.q);
  const double T1 = 0.5 * p1_.dot(contact_step_.end_velocity()), V1 = potential(q1_);
  // Friction that would do positive work excuses no gain.
  const double friction = std::min(0.0, contact_step_.friction_work());
  const double change = T1 + V1 - T0 - V0 - contact_step_.work() - friction;
  const double rounding = kPhaseRounding * (std::abs(V0) + std::abs(V1) + T0 + T1);
  if (std::abs(change) <= rounding || std::abs(change) <= contact_step_.energy_error(state_.p, p1_) + rounding)
    return false;
  contact_step_.reject(change > 0.0 ? "its energy rises" : "its energy vanishes");
  return true;
}

// The pair that overlaps most at q, among those that the last search found near and those with persistent contacts, and
// its gap; -1: none by more than is promised.
int Simulator::deepest_pair(const VecX& q, double& gap) {
  guards_.place(q);
  int deepest = -1;
  const auto look_at = [&](int guard) {
    if (!scene_->is_pair(guard) || guards_.is_apart(guard)) return;
    if (guards_.gap(guard) >= std::min(gap, -guards_.promised(guard))) return;
    deepest = guard;
    gap = guards_.gap(guard);
  };
  for (int guard : contacts_.guards_with_contacts()) look_at(guard);
  for (int guard : finder_.active()) look_at(guard);
  return deepest;
}

// Whether a pair that touches overlaps at the end of the contact step just solved by more than is promised, and more
// than at its start: then the step is rejected. One that overlaps already is recorded.
bool Simulator::sinks_in(Recording& recording, double time) {
  contact_step_.finish(q1_, p1_);
  if (!sinks_deeper(recording, time)) return false;
  contact_step_.reject("bodies would overlap");
  return true;
}

// As this, of the step that leads to q1_.
bool Simulator::sinks_deeper(Recording& recording, double time) {
  double least = 0.0;
  const int worst = deepest_pair(q1_, least);
  if (worst < 0) return false;
  guards_.place(state_.q);
  const double before = guards_.gap(worst);
  if (least < before - kFeatureRounding) return true;
  record_overlap(worst, least, time, recording);
  return false;
}

// A pair overlaps by more than is promised. Overlaps that are hardly deeper than one that was recorded are not.
void Simulator::record_overlap(int guard, double gap, double time, Recording& recording) {
  if (gap >= kDeeper * state_.deepest) return;
  state_.deepest = gap;
  recording.changes.push_back({time, guard, 0, Change::kOverlap, gap});
}

// Of gravity, springs and force fields [J].
double Simulator::potential(const VecX& q) {
  // The end of one step is the start of the next.
  if (q.size() != gravity_q_.size() || q != gravity_q_) {
    guards_.place(q);
    gravity_ = gravity_potential(scene_->tree, guards_.placements());
    gravity_q_ = q;
  }
  return total_potential(scene_->tree, integrator_.field(), gravity_, q);
}

// A guard that closes in its gap but not in its speed, event after event, does so by rounding of the gap: a short step
// without that guard leads past it.
void Simulator::step_past_rounding(int guard) {
  if (!zeno_.impacted().empty() || !state_.control.stands_still()) return;
  finder_.exempt(guard);
  state_.control.step_past_rounding(options_.dt, contact_dt());
}

// One contact step, to the end of the interval, to an event, or to a change of the contacts.
bool Simulator::advance_contact(Interval& interval, long halved, Recording& recording) {
  const auto clock = std::chrono::steady_clock::now();
  const double at = interval.start + interval.done, nominal = current_dt();
  contact_step_.set_time(at);
  const bool was_persistent = !contact_step_.contacts().empty();
  if (!update_contact_points(interval, recording)) return false;
  if (was_persistent && contact_step_.contacts().empty()) resume_free_motion(at);
  if (contact_step_.empty() && !has_phase()) return true;
  if (may_hold_contacts(at)) return advance_free(interval, halved, recording);
  const double parts = interval.parts(nominal);
  const double whole = interval.remaining / parts;
  const double h = std::min(whole, state_.control.contact.longest);
  record_phase(at, nominal, StepKind::kPersistent, recording);
  contact_step_.set_nominal(nominal);
  double alpha = 1.0;
  bool hit = false, again = false;
  bool solved = contact_step_.solve(state_.q, state_.p, h, interval.tau);
  while (solved && actuation_.saturate_servos(contact_step_.integrator())) {
    contact_step_.invalidate();
    solved = contact_step_.solve(state_.q, state_.p, h, interval.tau);
  }
  if (!solved || !first_contact_change(interval, h, alpha, hit, again, recording)) return retry_contact_step(h, at);
  if (h < whole) state_.control.contact.grow();
  if (again) {
    if (!state_.control.count_standstill())
      return end(StatusCode::kTooManyImpacts, at, "the persistent contacts change without end at one instant");
    if (contact_step_.contacts().empty()) resume_free_motion(at);
    return true;
  }
  const bool free = contact_step_.contacts().empty();
  const double taken = alpha * h;
  if (taken > 0.0 && (changes_energy() || sinks_in(recording, at + taken))) return retry_contact_step(h, at);
  if (taken > 0.0) {
    contact_step_.finish(q1_, p1_);
    if (!stays_in_range(at)) return false;
    state_.work.add(contact_step_);
    // Before the step is told that it is taken.
    if (hit && free)
      law_->evaluate_before({contact_step_, q1_, p1_, at + taken, interval.length}, taken, state_.step,
                            state_.reference);
    if (options_.gradient) keep_contact_step(h == whole ? 1.0 / parts : 0.0, hit, alpha < 1.0);
    accept_contact_step(at, taken, options_.dense, recording);
    interval.done += taken;
    interval.remaining =
        alpha >= 1.0 && h >= interval.remaining * (1.0 - 1e-12) ? 0.0 : interval.length - interval.done;
    // A step that an event cuts shorter than any that is tried leads nowhere: a contact may be released and close again
    // for ever.
    if (alpha >= 1.0 || taken >= StepControl::kShortest * nominal)
      state_.control.progress();
    else if (!state_.control.count_standstill())
      return end(StatusCode::kTooManyImpacts, at + taken, "the persistent contacts change without end at one instant");
    if (!hit || !free) law_->start_step(free_state(interval.start + interval.done), state_.reference);
  } else if (hit && free) {
    law_->evaluate_before(free_state(at, interval.length), 0.0, state_.step, state_.reference);
  }
  const double now = interval.start + interval.done;
  if (hit) {
    if (taken <= 0.0 && !state_.control.count_standstill()) {
      const int guard = finder_.event().guard;
      if (sequence_.holds(guard))
        return end(StatusCode::kConstraint, at, "constraints hold a point of a pair that closes at another: disable it",
                   guard);
      return end(StatusCode::kTooManyImpacts, at, "impacts without end at one instant", guard);
    }
    // What has opened before the event has no part in it.
    if (taken > 0.0) contacts_.release_separated(-1, true, now, interval.tau, recording);
    const Event& event = finder_.event();
    Stepper* rest = free ? &contact_step_ : nullptr;
    const bool resolved = resolve_event(
        event.guard, event.stays_closed,
        {now, free ? taken : 0.0, interval.remaining, interval.length, interval.tau, state_.step, rest}, recording);
    // An implicit map has chosen its impulse for the rest of the step, which therefore is solved as a whole.
    if (free && contact_step_.contacts().empty() && law_->implicit() && !zeno_.impacted().empty())
      state_.control.contact.allow(interval.remaining);
    if (resolved && taken <= 0.0) step_past_rounding(event.guard);
    state_.contact_seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - clock).count();
    return resolved;
  }
  contacts_.release_separated(changes_.releasing(), false, now, interval.tau, recording);
  changes_.set_releasing(-1);
  if (!free && contact_step_.contacts().empty()) resume_free_motion(now);
  state_.contact_seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - clock).count();
  return true;
}

// Finds the contact points again at a node. Points that have closed meanwhile and approach have an impact. False: the
// run has ended.
bool Simulator::update_contact_points(const Interval& interval, Recording& recording) {
  const Instant now{
      interval.start + interval.done, 0.0, interval.remaining, interval.length, interval.tau, state_.step, nullptr};
  const int changed = contacts_.find_points(now.time, recording);
  if (changed < 0) return true;
  // As at an event, points that close have an impact, and those that neither close nor separate persist.
  const std::vector<int> guards(contacts_.guards_with_contacts());
  if (!sequence_.collect(state_.q, state_.p, now.time, guards, changed, {}))
    return end(sequence_.code(), now.time, sequence_.message());
  const double slow = kSeparates * (1.0 + contact_step_.end_velocity().cwiseAbs().maxCoeff());
  double worst = 0.0;
  for (int i = 0; i < sequence_.count(); ++i) worst = std::min(worst, sequence_.closed(i).gamma_n(state_.p));
  if (worst < -slow) {
    zeno_.find_accumulating_impacts(state_.flights, sequence_, state_.p, now.time, shortest_nominal_step());
    if (!run_impacts(now, recording)) return end(sequence_.code(), now.time, sequence_.message(), sequence_.guard());
  }
  contacts_.close_contacts(-1, now.time, interval.tau, recording);
  return true;
}

// Keeps the contact step just solved. share: its length of what was left of the control step; 0: it does not depend on
// that. hit: it ends at an impact; cut: it ends before its length.
void Simulator::keep_contact_step(double share, bool hit, bool cut) {
  ContactStepRecord record = contact_step_.record();
  record.share = share;
  if (hit) {
    record.ending = ContactStepEnd::kImpact;
  } else if (cut && changes_.releasing() >= 0) {
    record.ending = ContactStepEnd::kRelease;
    record.ended = changes_.releasing();
  } else if (cut && changes_.stuck() >= 0) {
    record.ending = ContactStepEnd::kStick;
    record.ended = changes_.stuck();
  }
  kept_steps_.push_back(std::move(record));
}

// The end of the contact step (or partial step) of length h just solved becomes the state.
void Simulator::accept_contact_step(double time, double h, bool dense, Recording& recording) {
  if (dense) {
    integrator_.node_velocity(state_.q, state_.p, v_);
    contact_path_.set(state_.q, h, contact_step_.rates());
    contact_path_.raise(v_, contact_step_.end_velocity());
    const GaussTable& table = gauss_table(options_.stages);
    for (int j = 0; j < options_.stages; ++j) {
      contact_path_.chart_rate(table.c[j], v_);
      rates_.col(j) = v_;
    }
  }
  if (dense) {
    record_segment(time, h, p1_, recording);
    recording.segments.persistent.back() = Segments::kContactStep;
  }
  record_contact_forces(time, h, recording);
  contact_step_.commit();
  state_.q = q1_;
  state_.p = p1_;
}

void Simulator::record_contact_forces(double time, double h, Recording& recording) {
  const std::vector<ContactOutcome>& outcomes = contact_step_.outcomes();
  for (std::size_t i = 0; i < outcomes.size(); ++i) {
    const PersistentContact& persistent = contact_step_.contacts()[i];
    const ContactOutcome& out = outcomes[i];
    const double now = time + h;
    if (persistent.mu > 0.0 && persistent.sticks != !out.slips)
      record_change(now, persistent.point, out.slips ? Change::kSlip : Change::kStick, 0.0, recording);
    if (out.paradox <= 0.0 || out.jumps)
      record_change(time, persistent.point, Change::kInconsistent, out.paradox, recording);
    if (!options_.record_contacts) continue;
    if (!scene_->is_pair(persistent.point.guard)) {
      // A joint limit has no contact point: its impulse is the first of the three numbers.
      const Vec3 zero = Vec3::Zero();
      recording.contacts.push_back({time, h, persistent.point.guard, 0, ContactMode::kFrictionless, state_.step, zero,
                                    zero, out.position_impulse, out.velocity_impulse, out.contact.gap, zero});
      continue;
    }
    const Vec3 middle = 0.5 * (out.contact.point_a + out.contact.point_b);
    const ContactMode mode = persistent.mu == 0.0       ? ContactMode::kFrictionless
                             : out.slips || out.slipped ? ContactMode::kSlips
                                                        : ContactMode::kSticks;
    recording.contacts.push_back({time, h, persistent.point.guard, persistent.point.feature, mode, state_.step, middle,
                                  out.contact.normal, out.position_impulse_W, out.velocity_impulse_W, out.contact.gap,
                                  out.slip_W, out.friction_work});
  }
}

}  // namespace contactvi

// Simulator: steps in persistent contact, and the changes of contact inside a step, which are located like events.
//
// A contact step ends early at the first of: an impact of another guard; the release of a contact, where its continuous
// force comes to zero; the transition of a contact from slip to stick. The part up to there is solved again as a
// partial step.
#include <algorithm>
#include <chrono>
#include <cmath>

#include "base/root.hpp"
#include "run/simulator.hpp"
#include "step/energy.hpp"

namespace contactvi {

namespace {
constexpr double kShortest = 1e-6;       // of a contact step: steps are halved down to this length,
constexpr double kShortestSwing = 1e-9;  // and down to this one where a rim falls nearly flat
constexpr double kAtStart = 1e-10;       // of a contact step: an event that is earlier is at its start
constexpr int kEasySteps = 4;            // short steps solved one after the other before a longer one is tried
constexpr double kAlpha = 1e-13;         // of a step: accuracy to which changes of contact are located
constexpr double kSmallForce = 1e-12, kSmallSlip = 1e-11;  // of the forces, of the speeds: accurate enough for a root
constexpr int kLocatedSticks = 3;       // transitions to stick located per interval; the error of the others is O(h^2)
constexpr int kMaxEvaluations = 60;     // partial steps to locate one change
constexpr double kPastRounding = 1e-4;  // of a contact step: length of the step past an event by rounding
constexpr double kSameInstant = 1e-6;   // of a step: slips that end closer together end at one instant
constexpr double kCheckedGain = 1.2;    // of the kinetic energy: a step that gains less is not checked for its energy
constexpr double kLargestGain = 0.05;   // of the kinetic energy: gain allowed for the error of the step
constexpr double kEnergyRounding = 1e-7;  // [J] per joule of potential energy
constexpr double kForceRounding = 1e-9;   // of the largest force: contact forces below it are rounding

}  // namespace

bool Simulator::release_force(const VecX& tau, double alpha, double& value) {
  if (!contact_step_.solve_part(contact_path_, alpha, q_, p_, tau) || !contact_step_.persistent_forces(tau, forces_))
    return false;
  value = forces_[releasing_];
  return true;
}

// The first release of a contact in the contact step just solved, which ends at alpha: alpha becomes the fraction of
// the step at which the contact force comes to zero, and releasing_ the contact (-1: none). at_start: the force is zero
// at the start of the step already. False if the forces could not be found.
bool Simulator::find_release(const VecX& tau, double& alpha, bool& at_start) {
  releasing_ = -1;
  at_start = false;
  if (!contact_step_.may_release()) return true;
  if (!contact_step_.persistent_forces(tau, forces_)) return false;
  const double largest = forces_.cwiseAbs().maxCoeff();
  Eigen::Index worst;
  if (!(forces_.minCoeff(&worst) < -kForceRounding * largest)) return true;
  const VecX at_end = forces_;
  if (!contact_step_.persistent_forces_at(q_, p_, tau, forces_)) return false;
  const VecX before = forces_;
  double first = alpha;
  int found = -1;
  for (Eigen::Index i = 0; i < at_end.size(); ++i) {
    if (!(at_end[i] < -kForceRounding * largest)) continue;
    releasing_ = static_cast<int>(i);
    if (before[i] <= kForceRounding * largest) {
      // A contact that is released and closed again without progress stays: the step may also leave it without force.
      if (changes_without_progress_ >= kStandstill) {
        releasing_ = -1;
        continue;
      }
      at_start = true;
      return true;
    }
    double high_value = 0.0, root = first;
    if (first < alpha) {  // another contact is released at `first`: this one counts only if it is earlier
      if (!release_force(tau, first, high_value)) return false;
      if (high_value >= 0.0) continue;
    } else {
      high_value = at_end[i];
    }
    if (!root_by_value(
            before[i], first, high_value, kSmallForce * largest, kAlpha, kMaxEvaluations,
            [&](double x, double& f) { return release_force(tau, x, f); }, root))
      return false;
    first = root;
    found = static_cast<int>(i);
  }
  releasing_ = found;
  alpha = first;
  return contact_step_.solve_part(contact_path_, alpha, q_, p_, tau);
}

// Slip speed of the contact sticking_ at alpha if its friction went on beyond the end of the slip.
bool Simulator::remaining_slip(const VecX& tau, double alpha, double& value) {
  if (!contact_step_.solve_part(contact_path_, alpha, q_, p_, tau)) return false;
  value = contact_step_.slip_left(sticking_);
  return true;
}

// The first slip that comes to rest in the contact step just solved, which ends at alpha: alpha becomes the fraction of
// the step at which it does, and sticking_ its contact or joint (-1: none). False if a partial step was not solved.
bool Simulator::find_stick(const VecX& tau, double& alpha) {
  sticking_ = -1;
  if (sticks_located_ >= kLocatedSticks) return true;
  const double small = kSmallSlip * (1.0 + contact_step_.end_velocity().cwiseAbs().maxCoeff());
  ending_slips_.clear();
  for (int i = 0; i < contact_step_.slips(); ++i)
    if (contact_step_.slip_ends(i)) ending_slips_.push_back(i);
  bool located = false;
  for (int i : ending_slips_) {
    sticking_ = i;
    // The points of a face come to rest together: only a slip that clearly ends earlier is another one.
    const double high = located ? alpha * (1.0 - kSameInstant) : alpha;
    double high_value = 0.0, root = high;
    if (!remaining_slip(tau, high, high_value)) return false;
    if (high_value >= 0.0) continue;
    // The slip speed at the start of the step is not known here; any positive number brackets the root.
    if (!root_by_value(
            -high_value, high, high_value, small, kAlpha, kMaxEvaluations,
            [&](double x, double& f) { return remaining_slip(tau, x, f); }, root))
      return false;
    alpha = root;
    located = true;
  }
  if (located) ++sticks_located_;
  return sticking_ < 0 || contact_step_.solve_part(contact_path_, alpha, q_, p_, tau);
}

bool Simulator::retry_contact_step(double h, double time) {
  if (user_function_failed(time)) return false;
  const bool shortest = h < (contact_step_.rim_turns_far() ? kShortestSwing : kShortest) * current_dt();
  if (shortest && contact_step_.violated_constraint() >= 0)
    return end(StatusCode::kConstraint, time,
               "the constraints cannot be met, first " +
                   scene_->tree.elements.constraints[contact_step_.violated_constraint()].name);
  if (shortest)
    return end(StatusCode::kNewtonFailed, time,
               std::string("a step with persistent contacts was not solved: ") +
                   (*contact_step_.why() != 0 ? contact_step_.why() : "an event in it was not located"));
  contact_trial_dt_ = 0.5 * h;
  contact_solved_in_row_ = 0;
  ++halved_;
  contact_step_.invalidate();
  return true;
}

// After a contact step of length h was solved: the fraction alpha of it at which it has to end, and whether another
// guard has an impact there (hit). again: the contacts have changed at its start, and the step is to be solved again
// with them. False: a shorter step has to be tried.
bool Simulator::first_contact_change(const Interval& interval, double h, double& alpha, bool& hit, bool& again,
                                     Recording& recording) {
  alpha = 1.0;
  hit = again = false;
  contact_path_.set(q_, h, contact_step_.rates());
  contact_step_.finish(q1_, p1_);
  finder_.set_stepper(contact_step_);
  const Search found = finder_.search(q_, p_, q1_, p1_, h, interval.tau, contact_path_);
  if (found != Search::kNone && found != Search::kFound) return false;
  if (found == Search::kFound) {
    hit = true;
    alpha = finder_.event().alpha;
    if (alpha * h < kAtStart * contact_dt()) alpha = 0.0;
    if (alpha <= 0.0) return true;
    if (!contact_step_.solve_part(contact_path_, alpha, q_, p_, interval.tau)) return false;
  } else if (contact_step_.h() != h && !contact_step_.solve_part(contact_path_, 1.0, q_, p_, interval.tau)) {
    return false;  // solved again, because the search has solved partial steps
  }
  const double limit = alpha;
  bool at_start = false;
  // Where a release or the end of a slip cannot be located the step is accepted as it is: its impulses satisfy the
  // unilateral constraints and the friction cone.
  if (!find_release(interval.tau, alpha, at_start)) {
    releasing_ = -1;
    alpha = limit;
    at_start = false;
    if (!contact_step_.solve_part(contact_path_, alpha, q_, p_, interval.tau)) return false;
  }
  if (at_start) {
    const PersistentContact released_contact = contact_step_.contacts()[releasing_];
    separated_.emplace_back(released_contact.point.guard, released_contact.point.feature);
    contact_step_.contacts().erase(contact_step_.contacts().begin() + releasing_);
    update_persistent_guards();
    finder_.set_touching(released_contact.point.guard, true);
    if (!guards_.is_persistent(released_contact.point.guard)) finder_.exempt(released_contact.point.guard);
    record_change(interval.start + interval.done, released_contact.point, Change::kRelease, 0.0, recording);
    finder_.cut();
    again = true;
    return true;
  }
  const bool released = alpha < limit;
  const int releasing = releasing_;
  const double before_stick = alpha;
  if (!find_stick(interval.tau, alpha)) {
    alpha = before_stick;
    if (!contact_step_.solve_part(contact_path_, alpha, q_, p_, interval.tau)) return false;
  }
  releasing_ = released && alpha == before_stick ? releasing : -1;
  if (alpha < limit) {
    hit = false;
    finder_.cut();
  }
  return alpha <= 0.0 || !contact_step_.rim_turns_far() || h <= kShortestSwing * contact_dt();
}

// Whether the contact step just solved gains more energy than its error explains: then it is rejected. Contacts cannot
// do positive work, but a step in which a contact point jumps from one feature of a shape to another (a rim that falls
// flat on a face of which coal gives one point) may show such a gain.
bool Simulator::gains_energy() {
  contact_step_.finish(q1_, p1_);
  const double T1 = 0.5 * p1_.dot(contact_step_.end_velocity());
  if (T1 <= std::max(kCheckedGain * kinetic_, kEnergyRounding)) {
    kinetic_ = T1;
    return false;
  }
  const double work = contact_step_.work();
  const Energy after = energy(integrator_, q1_, p1_), before = energy(integrator_, q_, p_);
  const double rise = after.kinetic + after.potential - before.kinetic - before.potential - work;
  const double rounding = kEnergyRounding * (1.0 + std::abs(before.potential));
  if (rise > kLargestGain * std::max(before.kinetic, after.kinetic) + rounding) {
    contact_step_.reject("its energy rises");
    kinetic_ = 0.0;
    return true;
  }
  kinetic_ = T1;
  return false;
}

// A guard that closes in its gap but not in its speed, event after event, does so by rounding of the gap: a short step
// without that guard leads past it.
void Simulator::step_past_rounding(int guard) {
  if (!impacted_guards_.empty() || changes_without_progress_ < kStandstill) return;
  finder_.exempt(guard);
  contact_trial_dt_ = std::min(contact_trial_dt_, kPastRounding * contact_dt());
  trial_dt_ = std::min(trial_dt_, kPastRounding * options_.dt);
}

// One contact step, to the end of the interval, to an event, or to a change of the contacts.
bool Simulator::advance_contact(Interval& interval, Recording& recording) {
  const auto clock = std::chrono::steady_clock::now();
  const double at = interval.start + interval.done, nominal = current_dt();
  contact_step_.set_time(at);
  if (!update_contact_points(interval, recording)) return false;
  if (contact_step_.empty()) {
    resume_free_motion();
    return true;
  }
  const double whole = interval.remaining / std::max(1.0, std::ceil(interval.remaining / nominal - 1e-9));
  const double h = std::min(whole, contact_trial_dt_);
  record_phase(at, nominal, StepKind::kPersistent, recording);
  ++event_count_.contact_parts;
  contact_step_.set_nominal(nominal);
  double alpha = 1.0;
  bool hit = false, again = false;
  bool solved = contact_step_.solve(q_, p_, h, interval.tau);
  while (solved && saturate_servos(contact_step_.integrator())) {
    contact_step_.invalidate();
    solved = contact_step_.solve(q_, p_, h, interval.tau);
  }
  if (!solved || !first_contact_change(interval, h, alpha, hit, again, recording)) return retry_contact_step(h, at);
  if (h < whole && ++contact_solved_in_row_ >= kEasySteps) {
    contact_trial_dt_ *= 2.0;
    contact_solved_in_row_ = 0;
  }
  if (again) {
    if (++changes_without_progress_ > kMaxWithoutProgress)
      return end(StatusCode::kTooManyImpacts, at, "the persistent contacts change without end at one instant");
    if (contact_step_.empty()) resume_free_motion();
    return true;
  }
  const double taken = alpha * h;
  if (taken > 0.0 && gains_energy()) return retry_contact_step(h, at);
  if (taken > 0.0) {
    add_contact_work();
    accept_contact_step(at, taken, options_.dense, recording);
    interval.done += taken;
    interval.remaining =
        alpha >= 1.0 && h >= interval.remaining * (1.0 - 1e-12) ? 0.0 : interval.length - interval.done;
    changes_without_progress_ = 0;
    law_->start_step(q_, p_, reference_);
  }
  const double now = interval.start + interval.done;
  if (hit) {
    if (taken <= 0.0 && ++changes_without_progress_ > kMaxWithoutProgress)
      return end(StatusCode::kTooManyImpacts, at, "impacts without end at one instant", finder_.event().guard);
    const Event& event = finder_.event();
    const bool resolved =
        resolve_event(event.guard, event.stays_closed, {now, 0.0, interval.remaining, interval.tau, step_}, recording);
    if (resolved && taken <= 0.0) step_past_rounding(event.guard);
    contact_seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - clock).count();
    return resolved;
  }
  release_separated(now, recording);
  if (contact_step_.empty()) resume_free_motion();
  contact_seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - clock).count();
  return true;
}

// The end of the contact step (or partial step) of length h just solved becomes the state.
void Simulator::accept_contact_step(double time, double h, bool dense, Recording& recording) {
  if (dense) {
    integrator_.node_velocity(q_, p_, v_);
    contact_path_.set(q_, h, contact_step_.rates());
    contact_path_.raise(v_, contact_step_.end_velocity());
    const GaussTable& table = gauss_table(options_.stages);
    for (int j = 0; j < options_.stages; ++j) {
      contact_path_.chart_rate(table.c[j], v_);
      rates_.col(j) = v_;
    }
  }
  contact_step_.finish(q1_, p1_);
  if (dense) {
    record_segment(time, h, p1_, recording);
    recording.segments.persistent.back() = 1.0;
  }
  record_contact_forces(time, h, recording);
  contact_step_.commit();
  q_ = q1_;
  p_ = p1_;
}

}  // namespace contactvi

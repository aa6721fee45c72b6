// Simulator: steps while contacts are held, and what ends or changes them inside a step, located like events.
//
// A held step ends early at the first of: another guard's impact; a contact's release, where its continuous force comes
// to zero; a slip that comes to rest. What is cut off is solved again as a partial step that ends there.
#include <algorithm>
#include <chrono>
#include <cmath>

#include "base/root.hpp"
#include "run/simulator.hpp"
#include "step/energy.hpp"

namespace contactvi {

namespace {
constexpr double kShortest = 1e-6;                         // of a contact step: halving ends there
constexpr double kShortestSwing = 1e-9;                    // the same where a rim falls all but flat
constexpr double kNoTime = 1e-10;                          // of a contact step: an event so early is one at its start
constexpr int kEasySteps = 4;                              // short steps in a row before a longer one is tried
constexpr double kAlpha = 1e-13;                           // of a step: to what its events are located
constexpr double kSmallForce = 1e-12, kSmallSlip = 1e-11;  // of the forces, of the speeds: nothing to improve
constexpr int kMostSticks = 3;            // of an interval that are located; the others cost O(h^2), as their places do
constexpr int kMaxProbes = 60;            // partial steps to one of them
constexpr double kPastIt = 1e-4;          // of a contact step, past such a one
constexpr double kTogether = 1e-6;        // of a step: ends of slips nearer to each other are one
constexpr double kMoreSpeed = 1.2;        // of the kinetic energy: a step with less than this is not looked at
constexpr double kMostRise = 0.05;        // of the kinetic energy that a step may gain by being coarse
constexpr double kEnergyRounding = 1e-7;  // [J] of 1 J
constexpr double kNoForce = 1e-9;         // of the largest force: holding forces below it are rounding

}  // namespace

bool Simulator::release_value(const VecX& tau, double alpha, double& value) {
  if (!contact_step_.solve_part(contact_path_, alpha, q_, p_, tau) || !contact_step_.persistent_forces(tau, forces_))
    return false;
  value = forces_[releasing_];
  return true;
}

// The held step just solved ends at alpha; if a contact has left until then alpha becomes where. at_start: it leaves at
// once, whatever the step.
bool Simulator::find_release(const VecX& tau, double& alpha, bool& at_start) {
  releasing_ = -1;
  at_start = false;
  if (!contact_step_.may_release()) return true;
  if (!contact_step_.persistent_forces(tau, forces_)) return false;
  const double largest = forces_.cwiseAbs().maxCoeff();
  Eigen::Index worst;
  if (!(forces_.minCoeff(&worst) < -kNoForce * largest)) return true;
  const VecX at_end = forces_;
  if (!contact_step_.persistent_forces_at(q_, p_, tau, forces_)) return false;
  const VecX before = forces_;
  double first = alpha;
  int leaving = -1;
  for (Eigen::Index i = 0; i < at_end.size(); ++i) {
    if (!(at_end[i] < -kNoForce * largest)) continue;
    releasing_ = static_cast<int>(i);
    if (before[i] <= kNoForce * largest) {
      // Found closed again and again it stays: the step can do without its force as well.
      if (without_progress_ >= kStandstill) {
        releasing_ = -1;
        continue;
      }
      at_start = true;
      return true;
    }
    double high_value = 0.0, root = first;
    if (first < alpha) {  // an earlier one was found: is this one still earlier?
      if (!release_value(tau, first, high_value)) return false;
      if (high_value >= 0.0) continue;
    } else {
      high_value = at_end[i];
    }
    if (!root_by_value(
            before[i], first, high_value, kSmallForce * largest, kAlpha, kMaxProbes,
            [&](double x, double& f) { return release_value(tau, x, f); }, root))
      return false;
    first = root;
    leaving = static_cast<int>(i);
  }
  releasing_ = leaving;
  alpha = first;
  return contact_step_.solve_part(contact_path_, alpha, q_, p_, tau);
}

// Speed that is left of the slip at alpha, as if the friction went on beyond its end.
bool Simulator::stick_value(const VecX& tau, double alpha, double& value) {
  if (!contact_step_.solve_part(contact_path_, alpha, q_, p_, tau)) return false;
  value = contact_step_.slip_left(sticking_);
  return true;
}

// The held step just solved ends at alpha; where the first slip comes to rest before, alpha becomes when.
bool Simulator::find_stick(const VecX& tau, double& alpha) {
  sticking_ = -1;
  if (sticks_located_ >= kMostSticks) return true;
  const double small = kSmallSlip * (1.0 + contact_step_.end_velocity().cwiseAbs().maxCoeff());
  slip_ends_.clear();
  for (int i = 0; i < contact_step_.slips(); ++i)
    if (contact_step_.slip_ends(i)) slip_ends_.push_back(i);
  bool located = false;
  for (int i : slip_ends_) {
    sticking_ = i;
    // Points of a face come to rest together: only what does so clearly before is another end.
    const double high = located ? alpha * (1.0 - kTogether) : alpha;
    double high_value = 0.0, root = high;
    if (!stick_value(tau, high, high_value)) return false;
    if (high_value >= 0.0) continue;
    // The slip at the start of the step is not kept; any positive number brackets.
    if (!root_by_value(
            -high_value, high, high_value, small, kAlpha, kMaxProbes,
            [&](double x, double& f) { return stick_value(tau, x, f); }, root))
      return false;
    alpha = root;
    located = true;
  }
  if (located) ++sticks_located_;
  return sticking_ < 0 || contact_step_.solve_part(contact_path_, alpha, q_, p_, tau);
}

bool Simulator::contact_step_failed(double h, double time) {
  if (user_failed(time)) return false;
  const bool shortest = h < (contact_step_.swings() ? kShortestSwing : kShortest) * present_dt();
  if (shortest && contact_step_.unmet() >= 0)
    return end(StatusCode::kConstraint, time,
               "the constraints cannot be met, first " + scene_->tree.elements.constraints[contact_step_.unmet()].name);
  if (shortest)
    return end(StatusCode::kNewtonFailed, time,
               std::string("a step with held contacts was not solved: ") +
                   (*contact_step_.why() != 0 ? contact_step_.why() : "an event in it was not located"));
  contact_trial_ = 0.5 * h;
  contact_easy_ = 0;
  ++halved_;
  contact_step_.changed();
  return true;
}

// After a held step of length h was solved: where it has to end (alpha), and whether another guard is hit there. again:
// the contacts have changed instead, and the step is to be solved anew. False: it has to be tried shorter.
bool Simulator::first_change(const Piece& piece, double h, double& alpha, bool& hit, bool& again,
                             Recording& recording) {
  alpha = 1.0;
  hit = again = false;
  contact_path_.set(q_, h, contact_step_.rates());
  contact_step_.finish(q1_, p1_);
  finder_.set_stepper(contact_step_);
  const Search found = finder_.search(q_, p_, q1_, p1_, h, piece.tau, contact_path_);
  if (found != Search::kNone && found != Search::kFound) return false;
  if (found == Search::kFound) {
    hit = true;
    alpha = finder_.event().alpha;
    if (alpha * h < kNoTime * contact_dt()) alpha = 0.0;
    if (alpha <= 0.0) return true;
    if (!contact_step_.solve_part(contact_path_, alpha, q_, p_, piece.tau)) return false;
  } else if (contact_step_.h() != h && !contact_step_.solve_part(contact_path_, 1.0, q_, p_, piece.tau)) {
    return false;  // the search has looked at parts of the step
  }
  const double limit = alpha;
  bool at_start = false;
  // Where a release or the end of a slip cannot be located the step stands as it is, unilateral and within the cone.
  if (!find_release(piece.tau, alpha, at_start)) {
    releasing_ = -1;
    alpha = limit;
    at_start = false;
    if (!contact_step_.solve_part(contact_path_, alpha, q_, p_, piece.tau)) return false;
  }
  if (at_start) {
    const PersistentContact gone = contact_step_.contacts()[releasing_];
    separated_.emplace_back(gone.point.guard, gone.point.feature);
    contact_step_.contacts().erase(contact_step_.contacts().begin() + releasing_);
    sync_persistent();
    finder_.set_touching(gone.point.guard, true);
    if (!guards_.is_persistent(gone.point.guard)) finder_.exempt(gone.point.guard);
    note(piece.start + piece.done, gone.point, Change::kRelease, 0.0, recording);
    finder_.cut();
    again = true;
    return true;
  }
  const bool released = alpha < limit;
  const int releasing = releasing_;
  const double before_stick = alpha;
  if (!find_stick(piece.tau, alpha)) {
    alpha = before_stick;
    if (!contact_step_.solve_part(contact_path_, alpha, q_, p_, piece.tau)) return false;
  }
  releasing_ = released && alpha == before_stick ? releasing : -1;
  if (alpha < limit) {
    hit = false;
    finder_.cut();
  }
  return alpha <= 0.0 || !contact_step_.swings() || h <= kShortestSwing * contact_dt();
}

// Contacts take energy or leave it. A step in which a contact jumps from one place of two shapes to another (a rim that
// falls flat on a face, seen as coal's one point) can give some: it is refused. Of the step just solved.
bool Simulator::gains_energy() {
  contact_step_.finish(q1_, p1_);
  const double T1 = 0.5 * p1_.dot(contact_step_.end_velocity());
  if (T1 <= std::max(kMoreSpeed * kinetic_, kEnergyRounding)) {
    kinetic_ = T1;
    return false;
  }
  const double work = contact_step_.work();
  const Energy after = energy(integrator_, q1_, p1_), before = energy(integrator_, q_, p_);
  const double rise = after.kinetic + after.potential - before.kinetic - before.potential - work;
  const double rounding = kEnergyRounding * (1.0 + std::abs(before.potential));
  if (rise > kMostRise * std::max(before.kinetic, after.kinetic) + rounding) {
    contact_step_.refuse("its energy rises");
    kinetic_ = 0.0;
    return true;
  }
  kinetic_ = T1;
  return false;
}

// What closes in place but not in speed, again and again, is rounding of the places: a short step leads past it.
void Simulator::step_past(int guard) {
  if (!hit_.empty() || without_progress_ < kStandstill) return;
  finder_.exempt(guard);
  contact_trial_ = std::min(contact_trial_, kPastIt * contact_dt());
  trial_ = std::min(trial_, kPastIt * options_.dt);
}

// One held step, to the end of the interval, to an event, or to a change of the contacts.
bool Simulator::contact_piece(Piece& piece, Recording& recording) {
  const auto clock = std::chrono::steady_clock::now();
  const double at = piece.start + piece.done, nominal = present_dt();
  contact_step_.set_time(at);
  if (!refresh_points(piece, recording)) return false;
  if (contact_step_.empty()) {
    reanchor();
    return true;
  }
  const double whole = piece.remaining / std::max(1.0, std::ceil(piece.remaining / nominal - 1e-9));
  const double h = std::min(whole, contact_trial_);
  note_phase(at, nominal, true, recording);
  contact_step_.set_nominal(nominal);
  double alpha = 1.0;
  bool hit = false, again = false;
  bool solved = contact_step_.solve(q_, p_, h, piece.tau);
  while (solved && exceeds_effort(contact_step_.integrator())) {
    contact_step_.changed();
    solved = contact_step_.solve(q_, p_, h, piece.tau);
  }
  if (!solved || !first_change(piece, h, alpha, hit, again, recording)) return contact_step_failed(h, at);
  if (h < whole && ++contact_easy_ >= kEasySteps) {
    contact_trial_ *= 2.0;
    contact_easy_ = 0;
  }
  if (again) {
    if (++without_progress_ > kMaxWithoutProgress)
      return end(StatusCode::kTooManyImpacts, at, "the held contacts change without end at one instant");
    if (contact_step_.empty()) reanchor();
    return true;
  }
  const double taken = alpha * h;
  if (taken > 0.0 && gains_energy()) return contact_step_failed(h, at);
  if (taken > 0.0) {
    count_contact_work();
    take_contact_step(at, taken, options_.dense, recording);
    piece.done += taken;
    piece.remaining = alpha >= 1.0 && h >= piece.remaining * (1.0 - 1e-12) ? 0.0 : piece.length - piece.done;
    without_progress_ = 0;
    law_->start_step(q_, p_, reference_);
  }
  const double now = piece.start + piece.done;
  if (hit) {
    if (taken <= 0.0 && ++without_progress_ > kMaxWithoutProgress)
      return end(StatusCode::kTooManyImpacts, at, "impacts without end at one instant", finder_.event().guard);
    const Event& event = finder_.event();
    const bool resolved =
        resolve_event(event.guard, event.stays_closed, {now, 0.0, piece.remaining, piece.tau, step_}, recording);
    if (resolved && taken <= 0.0) step_past(event.guard);
    contact_seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - clock).count();
    return resolved;
  }
  drop_leaving(now, recording);
  if (contact_step_.empty()) reanchor();
  contact_seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - clock).count();
  return true;
}

// The held step (or its part) just solved, of length h, becomes the state.
void Simulator::take_contact_step(double time, double h, bool dense, Recording& recording) {
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
  record_contacts_of_step(time, h, recording);
  contact_step_.commit();
  q_ = q1_;
  p_ = p1_;
}

}  // namespace contactvi

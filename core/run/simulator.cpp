#include "run/simulator.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "impact/impact_maps.hpp"

namespace contactvi {

namespace {
constexpr double kSeparated = 1e-13;  // of the event's speeds: a slower closing speed is rounding
constexpr double kShortest = 1e-6;    // of a step: steps are halved down to this length
constexpr int kMostHalvings = 4000;   // and at most so often within one step
constexpr int kEasySteps = 4;         // short steps solved one after the other before a longer one is tried
constexpr double kFlights = 20.0;     // a free step after a short flight covers so many flights,
constexpr double kGrowth = 8.0;       // and grows by this factor while there is no event
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
}  // namespace

Simulator::Simulator(const Scene& scene, const SimulatorOptions& options)
    : scene_(&scene),
      options_(options),
      integrator_(scene.tree, options.stages, options.tol, options.max_iterations),
      guards_(scene, options.contact_points),
      finder_(scene, integrator_, guards_),
      path_(scene.tree, options.stages),
      q_(VecX::Zero(scene.tree.nq)),
      p_(VecX::Zero(scene.tree.nv)),
      q1_(scene.tree.nq),
      p1_(scene.tree.nv),
      v_(scene.tree.nv),
      rates_(scene.tree.nv, options.stages),
      bouncing_(scene.guard_count()),
      contact_step_(scene, guards_, guards_.manifolds(), options.tol),
      contact_path_(scene.tree, 1),
      sequence_(
          scene, integrator_, guards_,
          {options.impact, options.dt, options.stiff_support, options.max_impacts_per_step, options.record_contacts}),
      law_(&impact_law(options.impact)),
      plastic_(scene.guard_count(), 0) {
  reference_.kind = options.mhc_reference;
  const Elements& e = scene.tree.elements;
  dissipative_ = scene.tree.has_damping || !e.friction_dofs.empty() || !e.forces.empty() || e.servo_kd.size() > 0;
  for (const PathSpring& spring : e.path_springs) dissipative_ |= spring.damping > 0.0;
  does_work_ = dissipative_ || e.any_force() || e.constrained() || e.servo_kp.size() > 0;
}

bool Simulator::end(StatusCode code, double time, std::string message, int guard) {
  status_ = {code, std::move(message), time, guard, kNaN, kNaN};
  return false;
}

Status Simulator::reset(const VecX& q, const VecX& v, double t) {
  status_ = {StatusCode::kSuccess, "", t, -1, kNaN, kNaN};
  q_ = q;
  v_ = v;
  t0_ = time_ = t;
  step_ = halved_ = rejected_ = impacts_ = 0;
  largest_speed_ = 0.0;
  reference_.step = -1;
  trial_dt_ = options_.dt;
  solved_in_row_ = contact_solved_in_row_ = changes_without_progress_ = 0;
  contact_trial_dt_ = contact_dt();
  contact_seconds_ = kinetic_ = 0.0;
  contact_step_.contacts().clear();
  contact_step_.restart();
  work_ = Work();
  reactions_.setZero(scene_->tree.elements.constraint_rows);
  mean_reactions_ = reactions_;
  node_time_ = t;
  saturated_ = 0;
  scene_->tree.elements.forget_failure();
  servo_.any = false;
  integrator_.set_time(t);
  integrator_.set_servo(&servo_);
  contact_step_.set_time(t);
  contact_step_.set_servo(&servo_);
  contact_step_.set_nominal(options_.dt);
  separated_.clear();
  initial_changes_.clear();
  flight_dt_ = 0.0;
  contact_step_.counters = ContactStepCounters();
  update_persistent_guards();
  adaptive_dt_ = options_.dt;
  integrator_.counters = StepCounters();
  integrator_.forget();
  guards_.counters = GuardCounters();
  guards_.restart();
  bouncing_.assign(bouncing_.size(), Bouncing());
  if (!q.allFinite() || !v.allFinite()) {
    end(StatusCode::kNotFinite, t, "the start state is not finite");
    return status_;
  }
  integrator_.dynamics(q_, v_, p_, p1_);
  law_->start_run(free_state(), reference_);
  guards_.place(q_);
  finder_.forget_touching();
  guards_.list_meeting(meeting_guards_);
  for (int g : meeting_guards_) {
    Contact contact;
    const double gap = guards_.evaluate(g, contact), tolerance = guards_.touch_tolerance(g);
    if (gap <= tolerance) finder_.set_touching(g, true);
    if (!(gap >= -tolerance)) {
      end(StatusCode::kPenetration, t, "the start state is in penetration", g);
      status_.depth = -gap;
      return status_;
    }
  }
  if (allows_persistent_contact()) close_contacts_at_start();
  return status_;
}

void Simulator::record_node(double t, Recording& recording) {
  recording.t.push_back(t);
  recording.q.insert(recording.q.end(), q_.data(), q_.data() + q_.size());
  recording.p.insert(recording.p.end(), p_.data(), p_.data() + p_.size());
  if (!does_work_) return;
  recording.work.insert(recording.work.end(), {work_.input, work_.damping, work_.joint_friction, work_.driven});
  if (t > node_time_) {
    mean_reactions_ = reactions_ / (t - node_time_);
    reactions_.setZero();
    node_time_ = t;
  }
  recording.reactions.insert(recording.reactions.end(), mean_reactions_.data(),
                             mean_reactions_.data() + mean_reactions_.size());
}

// The step of length h from (q_, p_) whose rates are in rates_.
void Simulator::record_segment(double t, double h, const VecX& p1, Recording& recording) {
  if (!options_.dense) return;
  Segments& s = recording.segments;
  s.t.push_back(t);
  s.h.push_back(h);
  s.q.insert(s.q.end(), q_.data(), q_.data() + q_.size());
  s.p.insert(s.p.end(), p_.data(), p_.data() + p_.size());
  s.p1.insert(s.p1.end(), p1.data(), p1.data() + p1.size());
  s.rates.insert(s.rates.end(), rates_.data(), rates_.data() + rates_.size());
  s.persistent.push_back(0.0);
}

// True unless the caller asks to stop.
bool Simulator::report_progress(double time) {
  using Clock = std::chrono::steady_clock;
  if (!*progress_ || Clock::now() - last_report_ < std::chrono::milliseconds(100)) return true;
  last_report_ = Clock::now();
  return (*progress_)(time, impacts_) || end(StatusCode::kInterrupted, time, "interrupted");
}

Status Simulator::advance(long steps, const MatX& tau, const MatX& target, long record_every, const Progress& progress,
                          Recording& recording) {
  status_ = {StatusCode::kSuccess, "", time_, -1, kNaN, kNaN};
  VecX force;
  does_work_ |= tau.rows() > 0;
  if (recording.t.empty()) record_node(time_, recording);
  recording.changes.insert(recording.changes.end(), initial_changes_.begin(), initial_changes_.end());
  initial_changes_.clear();
  last_report_ = std::chrono::steady_clock::now();
  progress_ = &progress;
  for (long k = 0; k < steps; ++k) {
    if (tau.rows() > 0) force = tau.row(k).transpose();
    set_actuation(force, target, k);
    if (!advance_interval(t0_ + static_cast<double>(step_) * options_.dt, options_.dt, limited_tau_, recording)) {
      // Where the run ends inside a step, its last node is the state there.
      if (status_.code != StatusCode::kNotFinite && status_.time > recording.t.back())
        record_node(status_.time, recording);
      return status_;
    }
    ++step_;
    time_ = t0_ + static_cast<double>(step_) * options_.dt;
    if (step_ % record_every == 0 || k + 1 == steps) record_node(time_, recording);
    if (k % 64 == 63 && !report_progress(time_)) return status_;
  }
  status_.time = time_;
  return status_;
}

// After a step of length h that was not solved the next steps are half as long.
void Simulator::halve_step(double h) {
  trial_dt_ = 0.5 * h;
  solved_in_row_ = 0;
  ++halved_;
}

// Solves the smooth step of length h from (q_, p_) into (q1_, p1_). False where it was not solved; with last_try or
// after an error of a user's function the run has ended then.
bool Simulator::solve_smooth_step(double time, double h, const VecX& tau, bool last_try) {
  bool solved = integrator_.solve(q_, p_, h, tau);
  while (solved && saturate_servos(integrator_)) {
    integrator_.forget();
    solved = integrator_.solve(q_, p_, h, tau);
  }
  if (!solved) {
    if (user_function_failed(time)) return false;
    if (!last_try) return false;
    const bool finite = q_.allFinite() && p_.allFinite();
    return end(finite ? StatusCode::kNewtonFailed : StatusCode::kNotFinite, time,
               std::string("the discrete Euler-Lagrange equation was not solved: ") + integrator_.why());
  }
  truncation_ = std::max(truncation_, truncation_bound_ > 0.0 ? integrator_.truncation() : 0.0);
  integrator_.finish(q1_, p1_);
  if (guards_.count() > 0 || options_.dense) rates_ = integrator_.rates();
  integrator_.accept();
  return true;
}

bool Simulator::end_failed_search(Search outcome, double time) {
  if (outcome == Search::kNewtonFailed)
    return end(StatusCode::kNewtonFailed, time,
               std::string("a partial step to an event was not solved: ") + integrator_.why(), finder_.failed_guard());
  end(StatusCode::kEventUnresolved, time, "a guard crossed zero and its root was not found", finder_.failed_guard());
  status_.depth = -finder_.failed_gap();
  return false;
}

// The interval of one control step: steps as long as they can be, with the events in them.
bool Simulator::advance_interval(double start, double length, const VecX& tau, Recording& recording) {
  Interval interval{start, length, 0.0, length, tau};
  const long halved = halved_;
  long parts = 0;
  sequence_.begin_step();
  sticks_located_ = 0;
  law_->start_step(q_, p_, reference_);
  while (interval.remaining > 0.0) {
    if (++parts % 64 == 0 && !report_progress(start + interval.done)) return false;
    if (parts > 1) limit_actuation();
    if (!(contact_step_.empty() ? advance_free(interval, halved, recording) : advance_contact(interval, recording)))
      return false;
  }
  if (!q_.allFinite() || !p_.allFinite()) return end(StatusCode::kNotFinite, start + length, "the state is not finite");
  return true;
}

// One smooth step without contact, to the end of the interval or to an event in it.
bool Simulator::advance_free(Interval& interval, long halved, Recording& recording) {
  const double at = interval.start + interval.done;
  if (!recording.phase_t.empty())
    record_phase(at, truncation_bound_ > 0.0 ? adaptive_dt_ : options_.dt, false, recording);
  const double longest = flight_dt_ > 0.0 ? std::min(trial_dt_, flight_dt_) : trial_dt_;
  const bool shorter = longest < interval.remaining * (1.0 - 1e-9);
  const double h = shorter ? longest : interval.remaining;
  const bool last_try = truncation_bound_ > 0.0 || h < kShortest * options_.dt || halved_ - halved >= kMostHalvings;
  integrator_.set_time(at);
  if (!solve_smooth_step(at, h, interval.tau, last_try)) {
    if (last_try || scene_->tree.elements.user_failed()) return false;
    halve_step(h);
    return true;
  }
  const double input = does_work_ ? integrator_.input_work() : 0.0,
               damping = does_work_ ? integrator_.damping_loss() : 0.0;
  Search found = Search::kNone;
  if (guards_.count() > 0) {
    path_.set(q_, h, rates_);
    finder_.set_stepper(integrator_);
    found = finder_.search(q_, p_, q1_, p1_, h, interval.tau, path_);
  }
  if ((found == Search::kNewtonFailed || found == Search::kUnresolved) && !last_try) {
    integrator_.forget();  // solve_smooth_step has accepted the step
    halve_step(h);
    return true;
  }
  if (shorter && longest == trial_dt_ && ++solved_in_row_ >= kEasySteps) {
    trial_dt_ *= 2.0;
    solved_in_row_ = 0;
  }
  if (found == Search::kNone) {
    work_.input += input;
    work_.damping += damping;
    flight_dt_ = kGrowth * flight_dt_ < options_.dt ? kGrowth * flight_dt_ : 0.0;
    changes_without_progress_ = 0;
    record_segment(at, h, p1_, recording);
    q_.swap(q1_);
    p_.swap(p1_);
    interval.done += h;
    interval.remaining = shorter ? interval.length - interval.done : 0.0;
    if (interval.remaining > 0.0)
      law_->start_step(q_, p_, reference_);  // each part of a step that was cut counts as a step of its own
    return true;
  }
  if (found != Search::kFound) return end_failed_search(found, at);
  const Event& event = finder_.event();
  const double before = event.alpha * h;
  if (before > 0.0) {
    work_.input += integrator_.input_work();
    work_.damping += integrator_.damping_loss();
  }
  if (options_.dense && before > 0.0) rates_ = integrator_.rates();
  if (before > 0.0) record_segment(at, before, event.p, recording);
  integrator_.forget();
  interval.done += before;
  interval.remaining = event.alpha >= 1.0 && !shorter ? 0.0 : interval.length - interval.done;
  q_ = event.q;
  p_ = event.p;
  if (!resolve_event(event.guard, event.stays_closed, {at, before, interval.remaining, interval.tau, step_}, recording))
    return false;
  if (before <= 0.0 && impacted_guards_.empty()) {
    if (++changes_without_progress_ > kMaxWithoutProgress)
      return end(StatusCode::kTooManyImpacts, at, "contacts open and close without end at one instant", event.guard);
    step_past_rounding(event.guard);
  }
  // The polynomial of a whole step would be too coarse to show the next flight, if that is as short as the last one.
  const double flight = shortest_flight();
  flight_dt_ =
      !law_->implicit() && flight > 0.0 && kFlights * kFlights * flight < options_.dt ? kFlights * flight : 0.0;
  // An implicit map has chosen its impulse for the rest of the step, which therefore is solved as a whole.
  if (law_->implicit() && !impacted_guards_.empty()) trial_dt_ = std::max(trial_dt_, interval.remaining);
  return true;
}

// The impacts at the event of the guard `first`. stays_closed: it was touching and has not separated since. at.time is
// the start of the partial step that ends at the event.
bool Simulator::resolve_event(int first, bool stays_closed, const Instant& at, Recording& recording) {
  const double time = at.time + at.before;
  const Instant now{time, at.before, at.after, at.tau, at.step};
  const bool touched = finder_.touching(first), was_persistent = !contact_step_.empty();
  if (contact_step_.empty()) law_->evaluate_before(free_state(), at.before, step_, reference_);
  integrator_.set_time(time);
  contact_step_.set_time(time);
  if (!sequence_.collect(q_, p_, time, finder_.active(), first, contact_step_.contacts()))
    return end(sequence_.code(), time, sequence_.message());
  const double scale = sequence_.largest_speed(p_);
  largest_speed_ = std::max(largest_speed_, scale);
  find_accumulating_impacts(time);
  // A contact that has separated by rounding only has no impact with the closing speed that rounding has left.
  const bool rounding = (stays_closed || touched) && scale <= kSeparated * largest_speed_;
  const bool ran = rounding || run_impacts(now, recording);
  if (!ran) return end(sequence_.code(), time, sequence_.message(), sequence_.guard());
  for (int i = 0; i < sequence_.count(); ++i) finder_.set_touching(sequence_.closed(i).guard, true);
  if (!update_bouncing(first, stays_closed || touched, time, recording)) return false;
  bool any_hit = false;
  for (int i = 0; i < sequence_.count(); ++i) any_hit |= sequence_.closed(i).impacted;
  // A contact that closes again without a flight becomes persistent even if it separates: the step decides.
  if (allows_persistent_contact())
    close_contacts((stays_closed || touched) && !any_hit ? first : -1, time, at.tau, recording);
  if (was_persistent && contact_step_.empty()) resume_free_motion();
  return true;
}

// Free motion goes on where the last persistent contact has ended.
void Simulator::resume_free_motion() { law_->resume(free_state(), reference_); }

}  // namespace contactvi

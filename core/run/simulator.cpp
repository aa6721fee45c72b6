#include "run/simulator.hpp"

#include <algorithm>
#include <cmath>

#include "impact/impact_maps.hpp"
#include "model/coupling.hpp"
#include "run/state_range.hpp"

namespace contactvi {

namespace {
constexpr double kSeparated = 1e-13;  // of the event's speeds: a slower closing speed is rounding
constexpr int kMostHalvings = 4000;   // of the free steps within one interval
constexpr long kReported = 64;        // steps between two reports of progress
// Of an interval: what is left of it after a smooth step that ends within is no step of its own.
constexpr double kRounding = 1e-13;
// Two solutions of a step are one where their momenta differ by no more than these parts of what the step changes, and
// of the momenta themselves: equations are solved to less, other solutions differ by more.
constexpr double kSameSolution = 1e-6, kSameMomenta = 1e-10;

// Whether some force dissipates energy.
bool dissipates(const Tree& tree) {
  const Elements& e = tree.elements;
  bool any = tree.has_damping || !e.friction_dofs.empty() || !e.forces.empty() || e.servo_kd.size() > 0;
  for (const PathSpring& spring : e.path_springs) any |= spring.damping > 0.0;
  for (const CompliantContact& c : e.compliances) any |= c.law.dissipates();
  return any;
}

}  // namespace

// Order 2 is that of contact steps. Implicit maps solve steps of their own, which know no joint friction but that of
// contact steps, and beside rows have no derivative but that of those.
bool keeps_constraints(const Tree& tree, const SimulatorOptions& options) {
  const bool friction = !tree.elements.friction_dofs.empty(), ctec = options.impact == ImpactMap::kCtec;
  return options.stages > 1 && (ctec || !(options.gradient || friction));
}

bool has_turning_friction(const Scene& scene) {
  return std::any_of(scene.laws.begin(), scene.laws.end(),
                     [](const ContactLaw& law) { return law.turning_rows() > 0; });
}

Simulator::Simulator(const Scene& scene, const SimulatorOptions& options)
    : scene_(&scene),
      options_(options),
      law_(&impact_law(options.impact)),
      keeps_constraints_(keeps_constraints(scene.tree, options) && !has_turning_friction(scene)),
      keeps_joint_friction_(keeps_constraints_ && !scene.tree.elements.friction_dofs.empty()),
      dissipative_(dissipates(scene.tree)),
      does_work_(scene_does_work()),
      integrator_(scene.tree, options.stages, options.tol, options.max_iterations, keeps_constraints_),
      guards_(scene, options.contact_points),
      finder_(scene, integrator_, guards_),
      contact_step_(scene, guards_, guards_.manifolds()),
      dense_step_(scene, guards_, options.tol),
      costs_(scene.tree),
      sequence_(scene, integrator_, guards_,
                {options.impact, options.stiff_support, options.max_impacts_per_step, options.record_contacts,
                 options.gradient}),
      path_(scene.tree, options.stages),
      contact_path_(scene.tree, 1),
      actuation_(scene.tree, state_.actuators, integrator_, contact_step_, dense_step_),
      branches_(scene.tree, actuation_, integrator_),
      modes_(scene, guards_, contact_step_, integrator_),
      all_switches_(branches_, modes_),
      switches_(scene.tree, integrator_, all_switches_),
      long_steps_(scene.tree),
      zeno_(scene, dissipative_, allows_persistent_contact()),
      contacts_(scene, state_, integrator_, guards_, finder_, contact_step_, sequence_),
      changes_(state_, contact_step_, contact_path_),
      q1_(scene.tree.nq),
      p1_(scene.tree.nv),
      v_(scene.tree.nv),
      v_long_(scene.tree.nv),
      rates_(scene.tree.nv, options.stages),
      fresh_(memory()) {
  state_.q.setZero(scene.tree.nq);
  state_.p.setZero(scene.tree.nv);
  if (options.gradient) dense_step_.keep_records();
  if (keeps_constraints_) contact_step_.leave_fixed_rows_to_smooth_steps();
}

void Simulator::join(SideBySide& company) {
  in_company_ = true;
  integrator_.join(&company);
  actuation_.join(company);
}

// Whether the contacts that closed last may lose energy. Impacts that lose none end by themselves, and how often bodies
// hit each other then decides where they go: what it costs to locate them is no reason for dense steps.
bool Simulator::sequence_loses() {
  for (int i = 0; i < sequence_.count(); ++i)
    if (sequence_.closed(i).e < 1.0 || sequence_.closed(i).mu > 0.0) return true;
  return false;
}

bool Simulator::scene_does_work() const {
  const Elements& e = scene_->tree.elements;
  return dissipative_ || e.any_force() || e.constrained() || e.servo_kp.size() > 0 || !scene_->tree.followers.empty() ||
         scene_->contacts_depend_on_time();
}

bool Simulator::end(StatusCode code, double time, std::string message, int guard) {
  state_.status = {code, std::move(message), time, guard, kNaN, kNaN};
  return false;
}

Status Simulator::reset(const VecX& q, const VecX& v, double t) {
  if (start(q, v, t).ok()) close_contacts_at_start();
  return state_.status;
}

void Simulator::close_contacts_at_start() {
  if (allows_persistent_contact() && !state_.dense.active &&
      !contacts_.close_contacts_at_start([this](int rows, int points) { return locating_pays(rows, points); }))
    state_.dense.begin();
}

Status Simulator::start(const VecX& q, const VecX& v, double t) {
  VecX q0 = q, v0 = v;  // the arguments may be those of the state
  follow_configuration(scene_->tree, q0);
  follow_velocity(scene_->tree, v0);
  ActuatorState actuators = state_.actuators;
  state_ = RunState();
  state_.actuators = std::move(actuators);  // the references of servos stay
  state_.status = {StatusCode::kSuccess, "", t, -1, kNaN, kNaN};
  state_.q = q0;
  state_.p.resize(scene_->tree.nv);
  state_.start_time = state_.time = t;
  state_.reference.kind = options_.mhc_reference;
  state_.adaptive_dt = options_.dt;
  state_.control.start(options_.dt, contact_dt());
  scene_->tree.elements.forget_failure();
  actuation_.start();
  integrator_.set_time(t);
  contact_step_.contacts().clear();
  contact_step_.restart();
  gravity_q_.resize(0);
  if (options_.contact_steps == ContactSteps::kDense && allows_dense_steps()) state_.dense.begin();
  dense_step_.restart();
  contact_step_.set_time(t);
  contact_step_.set_nominal(options_.dt);
  contact_step_.counters = ContactStepCounters();
  dense_step_.counters = DenseStepCounters();
  contacts_.update_persistent_guards();
  integrator_.counters = StepCounters();
  integrator_.forget();
  guards_.counters = GuardCounters();
  guards_.restart();
  if (!in_range(q0, v0)) {
    end(StatusCode::kNotFinite, t, "the start state is not finite, or its energy overflows");
    return state_.status;
  }
  integrator_.dynamics(q0, v0, state_.p, p1_);
  state_.work.start(t, scene_->tree, state_.p, does_work_);
  if (!in_range(q0, state_.p)) {
    end(StatusCode::kNotFinite, t, "the momentum of the start state overflows");
    return state_.status;
  }
  if (!std::isfinite(state_.p.dot(v0)) || !std::isfinite(potential(q0))) {
    if (!user_function_failed(t)) end(StatusCode::kNotFinite, t, "the energy of the start state is not finite");
    return state_.status;
  }
  law_->start_run(free_state(t), state_.reference);
  guards_.place(q0);
  finder_.forget_touching();
  std::vector<int> meeting;
  guards_.list_meeting(meeting);
  for (int g : meeting) {
    Contact contact;
    const double gap = guards_.evaluate(g, contact), tolerance = Guards::kTouching;
    if (gap <= tolerance) finder_.set_touching(g, true);
    // A node of another run may be the start of this one.
    if (!(gap >= -(scene_->is_pair(g) ? guards_.promised(g) : tolerance))) {
      end(StatusCode::kPenetration, t, "the start state is in penetration", g);
      state_.status.depth = -gap;
      return state_.status;
    }
  }
  return state_.status;
}

void Simulator::record_node(double t, const double* q, const double* p, Recording& recording) {
  recording.t.push_back(t);
  recording.q.insert(recording.q.end(), q, q + state_.q.size());
  recording.p.insert(recording.p.end(), p, p + state_.p.size());
  state_.work.record_node(t, scene_->tree, recording);
}

void Simulator::record_phase(double time, double dt, StepKind kind, Recording& recording) const {
  recording.enter_phase(time, dt, kind, truncation_.bound > 0.0 ? state_.adaptive_dt : options_.dt);
}

// The step of length h from the state, whose rates are in rates_.
void Simulator::record_segment(double t, double h, const VecX& p1, Recording& recording) {
  if (!options_.dense) return;
  Segments& s = recording.segments;
  s.t.push_back(t);
  s.h.push_back(h);
  s.q.insert(s.q.end(), state_.q.data(), state_.q.data() + state_.q.size());
  s.p.insert(s.p.end(), state_.p.data(), state_.p.data() + state_.p.size());
  s.p1.insert(s.p1.end(), p1.data(), p1.data() + p1.size());
  s.rates.insert(s.rates.end(), rates_.data(), rates_.data() + rates_.size());
  s.persistent.push_back(0.0);
}

// True unless the caller asks to stop.
bool Simulator::report_progress(double time) {
  return reports_.ask(time, state_.impacts) || end(StatusCode::kInterrupted, time, "interrupted");
}

// The first node of a call, and what the reset has left to record.
void Simulator::start_recording(const Progress& progress, Recording& recording) {
  state_.status = {StatusCode::kSuccess, "", state_.time, -1, kNaN, kNaN};
  if (recording.t.empty()) record_node(state_.time, recording);
  std::vector<ChangeRecord>& initial = state_.initial_changes;
  recording.changes.insert(recording.changes.end(), initial.begin(), initial.end());
  initial.clear();
  reports_.begin(progress);
}

Status Simulator::advance(long steps, const MatX& tau, const MatX& target, long record_every, const Progress& progress,
                          Recording& recording) {
  VecX force;
  if (tau.rows() > 0) {
    does_work_ = true;
    state_.work.expect_inputs();
  }
  start_recording(progress, recording);
  long asked = 0;  // the step before which progress was reported
  for (long k = 0; k < steps;) {
    const long passed = tau.rows() > 0 ? 0 : pass_undisturbed_steps(steps - k, record_every, recording);
    k += passed;
    if (k - asked >= kReported) {
      asked = k;
      if (!report_progress(state_.time)) return state_.status;
    }
    if (passed > 0) continue;
    if (tau.rows() > 0) force = tau.row(k).transpose();
    const double start = state_.start_time + static_cast<double>(state_.step) * options_.dt;
    actuation_.set(start, force, target, k, state_.q, state_.p);
    if (!advance_interval(start, options_.dt, actuation_.force(), recording)) {
      // Where the run ends inside a step, its last node is the state there.
      if (state_.status.code != StatusCode::kNotFinite && state_.status.time > recording.t.back())
        record_node(state_.status.time, recording);
      state_.time = std::max(state_.time, state_.status.time);
      return state_.status;
    }
    ++state_.step;
    ++k;
    state_.time = state_.start_time + static_cast<double>(state_.step) * options_.dt;
    if (state_.step % record_every == 0 || k == steps) record_node(state_.time, recording);
  }
  state_.status.time = state_.time;
  return state_.status;
}

// Solves the smooth step of length h from the state into (q1_, p1_). False where it was not solved; with last_try or
// after an error of a user's function the run has ended then.
bool Simulator::solve_smooth_step(double time, double h, const VecX& tau, bool last_try) {
  const long before = integrator_.counters.stage_iterations;
  integrator_.limit_truncation(truncation_.limited ? truncation_.bound : kInfinity);
  integrator_.lead(guide_, time);
  const bool solved = integrator_.solve(state_.q, state_.p, h, tau);
  integrator_.limit_truncation(kInfinity);
  if (!solved) {
    if (user_function_failed(time)) return false;
    truncation_.too_long = integrator_.too_long();
    if (truncation_.too_long) {
      truncation_.largest = std::max(truncation_.largest, integrator_.truncation());
      return false;
    }
    if (!last_try) return false;
    const StageConstraints* constraints = integrator_.constraints();
    if (constraints && constraints->violated() >= 0) return end_violated(constraints->violated(), time);
    const bool finite = in_range(state_.q, state_.p);
    return end(finite ? StatusCode::kNewtonFailed : StatusCode::kNotFinite, time,
               std::string("the discrete Euler-Lagrange equation was not solved: ") + integrator_.why());
  }
  if (truncation_.bound > 0.0) {
    // Where it is lost in what the solution of the stage equations resolves, shorter steps leave out no less.
    const double seen = integrator_.truncation();
    const bool resolved = seen > integrator_.resolution();
    truncation_.largest = std::max(truncation_.largest, resolved ? seen : std::min(seen, truncation_.bound));
    truncation_.iterations = std::max(truncation_.iterations, integrator_.counters.stage_iterations - before);
  }
  integrator_.finish(q1_, p1_);
  if (options_.dense) rates_ = integrator_.rates();
  integrator_.accept();
  return true;
}

// Whether the state after the step just solved can be taken; if not, the run ends with the state before it.
bool Simulator::stays_in_range(double time) {
  return in_range(q1_, p1_) ||
         end(StatusCode::kNotFinite, time, "the state after a step is not finite, or its energy overflows");
}

bool Simulator::end_failed_search(Search outcome, double time) {
  if (outcome == Search::kNewtonFailed)
    return end(StatusCode::kNewtonFailed, time,
               std::string("a partial step to an event was not solved: ") + integrator_.why(), finder_.failed_guard());
  end(StatusCode::kEventUnresolved, time, "a guard crossed zero and its root was not found", finder_.failed_guard());
  state_.status.depth = -finder_.failed_gap();
  return false;
}

// The interval of one control step: steps as long as they can be, with the events in them.
bool Simulator::advance_interval(double start, double length, const VecX& tau, Recording& recording) {
  if (scene_->tree.nv == 0) return true;  // nothing moves
  Interval interval{start, length, 0.0, length, tau};
  const long halved = state_.control.halved;
  long parts = 0;
  sequence_.begin_step();
  sequence_.forget();
  changes_.begin_interval();
  const bool dense_allowed = allows_dense_steps();
  double spent = 0.0;
  bool only_free = true;
  flew_ = flew_once_ = false;
  const long impacts = state_.impacts;
  if (state_.dense.active && dense_may_end()) end_dense_phase();
  if (!state_.dense.active) ++state_.dense.since_return;
  law_->start_step(free_state(start), state_.reference);
  if (!branches_.none()) branches_.begin_interval();
  while (interval.remaining > 0.0) {
    interval.checked = false;
    if (parts++ > 0) {
      if (!report_progress(start + interval.done)) return false;
      if (!interval.keeps_branches) actuation_.limit(start + interval.done, state_.q, state_.p);
    }
    if (state_.dense.active) {
      only_free = false;
      state_.watch.known = false;
      if (!advance_dense(interval, recording)) return false;
      count_saturated(false);
      continue;
    }
    const double cost = located_cost();
    const bool phase = !contact_step_.empty() || has_phase();
    if (phase) state_.watch.known = false;  // friction takes energy there
    only_free &= !phase;
    const bool smooth = !phase || may_hold_contacts(start + interval.done);
    const long before = state_.impacts;
    const bool going = phase ? advance_contact(interval, halved, recording) : advance_free(interval, halved, recording);
    modes_.end_step();
    if (!branches_.none()) branches_.end_step();
    count_saturated(smooth);
    // What is held by constraints or joint friction alone has no other steps, and a smooth step without an impact costs
    // what its order does.
    const bool touched = !contact_step_.contacts().empty() || sequence_loses();
    if (touched && !interval.checked) spent += located_cost() - cost;
    if (truncation_.after_impact > 1 && state_.impacts > before)
      state_.control.free.longest =
          std::min(state_.control.free.longest, interval.remaining / truncation_.after_impact);
    if (truncation_.too_long) {
      truncation_.first = parts == 1;
      return false;
    }
    const bool shortened = !going && may_be_shortened(length, impacts);
    if (dense_allowed && !shortened && (going ? events_accumulate(spent, length) : dense_steps_go_on()))
      begin_dense_phase();
    else if (!going)
      return false;
    // A step that was solved from other start values after a call has failed counts, but it is the last one.
    if (user_function_failed(start + interval.done)) return false;
  }
  flew_ = only_free;
  flew_once_ = flew_ && options_.stages == 1 && parts == 1 && state_.impacts == impacts;
  if (spent > 0.0 || state_.dense.located.excess > 0.0) state_.dense.located.add(spent, allowed_cost(length));
  if (!interval.checked && !in_range(state_.q, state_.p))
    return end(StatusCode::kNotFinite, start + length, "the state is not finite, or its energy overflows");
  return true;
}

// One smooth step, to the end of the interval or to an event in it. Persistent contacts are held in it.
bool Simulator::advance_free(Interval& interval, long halved, Recording& recording) {
  StepControl& control = state_.control;
  const double at = interval.start + interval.done;
  const double longest = control.longest_free();
  bool halves = longest < interval.remaining * (1.0 - 1e-9);
  double h = halves ? longest : interval.remaining;
  const bool holds = has_phase();
  const bool touches = !contact_step_.contacts().empty();
  const bool last_try = !holds && (truncation_.bound > 0.0 || h < StepControl::kShortest * options_.dt ||
                                   control.halved - halved >= kMostHalvings);
  integrator_.set_time(at);
  if (!branches_.none()) {
    if (!begin_branches(interval)) return false;
    const double limit = branches_.limit(h, interval.length, state_.q, v_);
    halves |= limit < h;
    h = limit;
  }
  if (holds) {
    if (!integrator_.node_velocity(state_.q, state_.p, v_) ||
        !modes_.begin_step(state_.q, v_, at, interval.tau, recording))
      return leave_to_contact_steps(at);
  }
  // A run that chooses its steps learns from one that is too long to be solved.
  const bool learns = last_try || (truncation_.bound > 0.0 && !is_as_contact_step(h));
  if (!solve_smooth_step(at, h, interval.tau, learns)) {
    if (truncation_.too_long || learns || scene_->tree.elements.user_failed()) return false;
    return shorten_step(h, at);
  }
  const long iterations = integrator_.counters.stage_iterations;
  const auto reject = [&] {  // solve_smooth_step has accepted the step
    integrator_.forget();
    return shorten_step(h, at);
  };
  if (holds && modes_.is_undetermined()) return leave_to_contact_steps(at);
  if (holds && (!modes_.fits(q1_, true) || !held_step_keeps_energy())) return reject();
  // Adaptive steps are as short as their stages need; an implicit map has its own energy, and an impulse for the whole
  // step.
  if (truncation_.bound == 0.0 && !last_try && !law_->implicit() &&
      long_steps_.may_be_long(integrator_.stage_velocities(), integrator_.padded_stages(), h) &&
      long_steps_.is_long(integrator_, h) && !keeps_energy(state_.watch, step_energy()))
    return reject();
  if (holds) modes_.take_step(h, v_, q1_, interval.tau);
  bool switches = false;  // the step is to end where a branch does
  if (branches_.count() > 0) branches_.take_step(at, h);
  if (branches_.count() > 0 || modes_.count() > 0) {
    const Search found = switches_.search(state_.q, state_.p, v_, q1_, p1_, h, interval.tau);
    if (found != Search::kNone) integrator_.forget();
    if (found == Search::kFound) {
      if (switches_.alpha() <= 0.0) return enter_branch(interval, state_.q, v_, false, recording);
      switches = true;
      h *= switches_.alpha();
      q1_ = switches_.q();
      p1_ = switches_.p();
      if (options_.dense) rates_ = integrator_.rates();
    } else if (found != Search::kNone) {
      if (last_try) return end_failed_switch(found, at);
      return reject();
    }
    if (holds && !modes_.fits(q1_, false)) return reject();
  }
  if (!branches_.none() && truncation_.bound == 0.0 && !last_try && branches_.presses_nonlinearly() &&
      !contacts_keep_energy(scene_->tree, step_energy(), state_.q, q1_))
    return reject();
  const bool shorter = halves || switches;
  if (holds)
    record_phase(at, truncation_.bound > 0.0 ? truncation_.length : options_.dt, StepKind::kPersistent, recording);
  else if (!recording.phase_t.empty())
    record_phase(at, truncation_.bound > 0.0 ? state_.adaptive_dt : options_.dt, StepKind::kFree, recording);
  if (!stays_in_range(at)) return false;
  const WorkAccount::FreeWork work = state_.work.of(integrator_);
  Search found = Search::kNone;
  if (guards_.count() > 0 || follows_motion_) {
    finder_.set_stepper(integrator_);
    if (!finder_.passes(state_.q, state_.p, q1_, p1_, h, integrator_.only_rate())) {
      path_.set(state_.q, h, integrator_.rates());
      found = finder_.search(state_.q, state_.p, q1_, p1_, h, interval.tau, path_);
    }
  }
  if ((found == Search::kNewtonFailed || found == Search::kUnresolved) && !last_try) return reject();
  if (halves && !switches && longest == control.free.longest) control.free.grow();
  if (found == Search::kFound) {
    if (!branches_.none()) branches_.end_step();
    interval.keeps_branches = false;
    return take_event(interval, h, shorter, recording);
  }
  if (found != Search::kNone) return end_failed_search(found, at);
  // The search may have solved parts of the step: its impulses are to be those of the whole.
  const bool searched = integrator_.counters.stage_iterations != iterations;
  if (searched && (holds || keeps_held_steps()) && !solve_again(h, interval.tau)) return reject();
  if (holds) {
    if (sinks_deeper(recording, at + h)) return reject();
    if (!modes_.admits()) return modes_.needs_contact_steps() ? leave_to_contact_steps(at) : reject();
    if (keeps_held_steps()) keep_held_step(switches);
    modes_.commit(at, state_.step, options_.record_contacts, recording);
  } else if (keeps_held_steps()) {
    keep_held_step(false);
  }
  state_.work.add(work);
  control.flew(options_.dt);
  record_segment(at, h, p1_, recording);
  if (holds && options_.dense) recording.segments.persistent.back() = Segments::kHeld;
  state_.q.swap(q1_);
  state_.p.swap(p1_);
  if (!holds && !finder_.active().empty()) {
    double gap = 0.0;
    const int guard = deepest_pair(state_.q, gap);
    if (guard >= 0) record_overlap(guard, gap, at + h, recording);
  }
  interval.checked = true;
  interval.done += h;
  const double rest = shorter ? interval.length - interval.done : 0.0;
  interval.remaining = rest > kRounding * interval.length ? rest : 0.0;
  interval.keeps_branches = false;
  // Changes of contact may follow each other for ever where rounding decides about them.
  const bool moved = !holds || h > StepControl::kShortest * options_.dt;
  if (switches) enter_branch(interval, state_.q, switches_.v(), moved, recording);
  modes_.end_step();
  if (holds && moved) control.progress();
  if (touches && contact_step_.contacts().empty()) resume_free_motion(interval.start + interval.done);
  // Each part of a step that was cut counts as a step of its own.
  if (interval.remaining > 0.0) law_->start_step(free_state(interval.start + interval.done), state_.reference);
  return true;
}

// Solves the step of length h to (q1_, p1_) once more, after parts of it along path_. False: it is not solved, or from
// these start values it has another solution, as steps may have in which several contacts slip: its impulses would not
// be those of the motion.
bool Simulator::solve_again(double h, const VecX& tau) {
  if (integrator_.length() != h && !integrator_.solve_part(path_, 1.0, state_.q, state_.p, tau)) return false;
  VecX q(q1_.size()), p(p1_.size());
  integrator_.finish(q, p);
  return (p - p1_).cwiseAbs().maxCoeff() <=
         kSameSolution * (p1_ - state_.p).cwiseAbs().maxCoeff() + kSameMomenta * p1_.cwiseAbs().maxCoeff();
}

StepEnergy Simulator::step_energy() {
  const WorkTally& done = state_.work.tally();
  const double work = done.input + done.driven - done.damping - done.joint_friction;
  const auto kinetic = [this](const VecX& q, const VecX& p) {
    return integrator_.node_velocity(q, p, v_long_) ? 0.5 * p.dot(v_long_) : kNaN;
  };
  const double V0 = potential(state_.q), V1 = potential(q1_), T0 = kinetic(state_.q, state_.p);
  const double step_work = integrator_.work() + modes_.friction_work();
  return {T0 + V0 - work, kinetic(q1_, p1_) + V1 - work - step_work, T0, V1 - V0};
}

// The part of a smooth step of length h up to the event that was found in it, and the event. shorter: the step does not
// reach the end of the interval.
bool Simulator::take_event(Interval& interval, double h, bool shorter, Recording& recording) {
  const Event& event = finder_.event();
  const double at = interval.start + interval.done, before = event.alpha * h;
  const bool holds = modes_.active();
  if (before > 0.0) {
    if (keeps_held_steps()) keep_held_step(false);
    if (holds) modes_.commit(at, state_.step, options_.record_contacts, recording);
    state_.work.add(state_.work.of(integrator_));
    if (options_.dense) rates_ = integrator_.rates();
    record_segment(at, before, event.p, recording);
    if (holds && options_.dense) recording.segments.persistent.back() = Segments::kHeld;
  }
  modes_.end_step();
  integrator_.forget();
  state_.watch.known = false;
  interval.done += before;
  interval.remaining = event.alpha >= 1.0 && !shorter ? 0.0 : interval.length - interval.done;
  state_.q = event.q;
  state_.p = event.p;
  if (!holds) law_->evaluate_before(free_state(at + before, interval.length), before, state_.step, state_.reference);
  const Instant instant{at + before, holds ? 0.0 : before,          interval.remaining, interval.length, interval.tau,
                        state_.step, holds ? nullptr : &integrator_};
  if (!resolve_event(event.guard, event.stays_closed, instant, recording)) return false;
  StepControl& control = state_.control;
  if (before < StepControl::kShortest * shortest_nominal_step() && zeno_.impacted().empty()) {
    if (!control.count_standstill())
      return end(StatusCode::kTooManyImpacts, at, "contacts open and close without end at one instant", event.guard);
    step_past_rounding(event.guard);
  }
  control.expect_flight(law_->implicit() ? 0.0 : zeno_.shortest_flight(state_.flights), options_.dt);
  // An implicit map has chosen its impulse for the rest of the step, which therefore is solved as a whole.
  if (law_->implicit() && !zeno_.impacted().empty()) control.free.allow(interval.remaining);
  return true;
}

// Runs the impacts at one instant and adds the reactions and the work of constraints in them. False: they do not end.
bool Simulator::run_impacts(const Instant& now, Recording& recording) {
  const bool ended = sequence_.run(now, zeno_.plastic(), state_.reference, state_.p, recording);
  state_.impacts += sequence_.impacts();
  state_.work.add(sequence_);
  return ended;
}

// True if a function of the user has failed: the run ends, for no step after that can be trusted.
bool Simulator::user_function_failed(double time) {
  if (!scene_->tree.elements.user_failed()) return false;
  end(StatusCode::kNotFinite, time, "a function of the user failed");
  return true;
}

// The shortest nominal length of steps, with which flights are compared [s].
double Simulator::shortest_nominal_step() const { return std::min({state_.adaptive_dt, contact_dt(), options_.dt}); }

// The impacts at the event of the guard `first`. stays_closed: it was touching and has not separated since.
bool Simulator::resolve_event(int first, bool stays_closed, const Instant& now, Recording& recording) {
  const double time = now.time;
  const bool touched = finder_.touching(first), was_persistent = !contact_step_.contacts().empty();
  integrator_.set_time(time);
  contact_step_.set_time(time);
  if (!sequence_.collect(state_.q, state_.p, time, finder_.active(), first, contact_step_.contacts()))
    return end(sequence_.code(), time, sequence_.message());
  const double scale = sequence_.largest_speed(state_.p);
  state_.largest_speed = std::max(state_.largest_speed, scale);
  zeno_.find_accumulating_impacts(state_.flights, sequence_, state_.p, time, shortest_nominal_step());
  // A contact that has separated by rounding only has no impact with the closing speed that rounding has left.
  const bool rounding = (stays_closed || touched) && scale <= kSeparated * state_.largest_speed;
  const bool ran = rounding || run_impacts(now, recording);
  if (!ran) return end(sequence_.code(), time, sequence_.message(), sequence_.guard());
  for (int i = 0; i < sequence_.count(); ++i) finder_.set_touching(sequence_.closed(i).guard, true);
  if (!zeno_.update_bouncing(state_.flights, sequence_, time, shortest_nominal_step(), state_.adaptive_dt, recording)) {
    end(StatusCode::kZeno, time, "impacts accumulate", zeno_.accumulating());
    state_.status.accumulation_time = zeno_.ends();
    return false;
  }
  for (int guard : zeno_.impacted()) finder_.end_exemption(guard);
  const bool any_hit = !zeno_.impacted().empty();
  if (!any_hit && (stays_closed || touched) && !allows_persistent_contact()) {
    end(StatusCode::kZeno, time, "a contact stays closed", first);
    state_.status.accumulation_time = time;
    return false;
  }
  // A contact that closes again without a flight becomes persistent even if it separates: the step decides.
  if (allows_persistent_contact())
    contacts_.close_contacts((stays_closed || touched) && !any_hit ? first : -1, time, now.tau, recording);
  // An impact, and the steps that a map has tried after it, leave nothing from which the next step could go on.
  contact_step_.invalidate();
  if (was_persistent && contact_step_.contacts().empty()) resume_free_motion(time);
  return true;
}

}  // namespace contactvi

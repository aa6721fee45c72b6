// The event loop: smooth steps, events, impacts, and the status a run ends with.
#pragma once

#include <algorithm>
#include <cmath>
#include <functional>
#include <memory>

#include "contact/held_step_record.hpp"
#include "model/step_costs.hpp"
#include "run/contact_change.hpp"
#include "run/contact_modes.hpp"
#include "run/contact_set.hpp"
#include "run/progress.hpp"
#include "run/run_state.hpp"
#include "run/side_by_side.hpp"

namespace contactvi {

// Steps of a run with dt="auto" that are parts of those of another one.
struct StepPlan {
  const Recording& run;  // the other one
  double part;
  bool planned;  // whether its steps were parts of those of yet another one
};

// How Simulator::run_auto chooses its steps.
struct AutoSteps {
  double level;                    // what the highest mode of the stage velocities moves at most in a step [m; rad]
  const StepPlan* plan = nullptr;  // null: none
  double sample = 0.0;  // smooth steps that are not much longer end at its multiples [s]; 0: at no such times
  const std::vector<double>* ends = nullptr;  // at these times steps end, too [s], ascending; null: there are none
  // Steps, at least, from an impact to the end of the step that it is in. Two runs may end that step at the same time;
  // what comes after the impact shows no error in their distance if both make it in one step.
  int after_impact = 1;
  MatX target = MatX();  // references of the servos, (1, 2 nv): constant; no rows: there are none, or they move
  const MovingReferences* references = nullptr;  // those that move
};

struct SimulatorOptions {
  double dt = 1e-3;    // [s]
  double tol = 1e-12;  // of the discrete Euler-Lagrange residual, relative
  ImpactMap impact = ImpactMap::kCtec;
  MhcReference mhc_reference = MhcReference::kStep;
  int max_iterations = 50;  // stage iterations per attempt at a step
  long max_impacts_per_step = 100000;
  int stages = 1;              // s of order 2s
  bool dense = false;          // keep the polynomials of the steps
  double dt_contact = 0.0;     // step in persistent contact [s]; 0: dt
  bool end_at_zeno = false;    // the run ends where impacts accumulate or a contact stays closed
  bool stiff_support = false;  // persistent contacts are rigid supports in an impact instead of partners
  int contact_points = 4;      // of a pair, at most
  bool record_contacts = true;
  bool gradient = false;  // contact steps and impacts of several points are kept for derivatives
  bool islands = true;    // islands are advanced one by one where that is possible (run/world.hpp)
  int threads = 1;        // that advance islands side by side, where no function of the user is called
  ContactSteps contact_steps = ContactSteps::kAuto;
};

// Whether the smooth steps of a run keep the scene's constraints, persistent contacts and joint friction; else contact
// steps do.
bool keeps_constraints(const Tree& tree, const SimulatorOptions& options);
// Whether some pair has friction against spinning or rolling: then persistent contacts are left to contact steps, and
// there are no dense steps.
bool has_turning_friction(const Scene& scene);

class Simulator {
 public:
  Simulator(const Scene& scene, const SimulatorOptions& options);

  // State in engine coordinates. Fails with kPenetration or kNotFinite.
  Status reset(const VecX& q, const VecX& v, double t);
  // Makes `steps` steps of dt. tau: generalized force, constant over each step (steps x nv, public coordinates, or
  // empty). target: references of the servos q_ref, v_ref (steps x 2 nv), or empty where they stay what they are. Nodes
  // are recorded every record_every steps. The run may end early: see the status.
  Status advance(long steps, const MatX& tau, const MatX& target, long record_every, const Progress& progress,
                 Recording& recording);
  // Runs for `duration` [s] with steps of equal length between one impact and the next, as far as samples
  // allow, such that the highest mode of the stage velocities moves nothing by more than the level per step
  // (Integrator::truncation). A step in which it does is given up, and shorter ones follow up to the next impact. While
  // contacts persist the steps have the length of contact steps. Every step's end is a node.
  Status run_auto(double duration, const AutoSteps& steps, const Progress& progress, Recording& recording);

  // From now on smooth steps start from where another run of the same motion has gone; null: no longer. The guide stays
  // the caller's.
  void follow(Guide* guide) { guide_ = guide; }

  // From now on the contact problems of steps are kept there; null: no longer. The log stays the caller's.
  void keep_problems(ProblemLog* log) {
    contact_step_.keep_problems(log);
    dense_step_.keep_problems(log);
  }

  double time() const { return state_.time; }
  const VecX& q() const { return state_.q; }
  const VecX& p() const { return state_.p; }
  const RunState& state() const { return state_; }
  const Scene& scene() const { return *scene_; }
  const SimulatorOptions& options() const { return options_; }
  const StepCounters& step_counters() const { return integrator_.counters; }
  const GuardCounters& guard_counters() const { return guards_.counters; }
  const ContactStepCounters& contact_counters() const { return contact_step_.counters; }
  const DenseStepCounters& dense_counters() const { return dense_step_.counters; }

  // The contact steps kept since the last call of this, without those of islands.
  std::vector<ContactStepRecord> take_contact_steps() { return std::exchange(kept_steps_, {}); }
  std::vector<DenseStepRecord> take_dense_steps() { return std::exchange(kept_dense_steps_, {}); }
  std::vector<HeldStepRecord> take_held_steps() { return std::exchange(kept_held_steps_, {}); }
  std::vector<ImpactBlockRecord> take_impact_blocks() { return sequence_.take_blocks(); }

  // Makes it what it was when it was made: the next reset() starts a run with the same digits as a new simulator.
  void renew();
  // Forgets that inputs have done work.
  void forget_inputs();

  // For bodies that are one island of a larger scene (run/world.hpp).
  // The engine's memory as it is before any run, with which every island starts.
  EngineMemory memory();
  // All but the state.
  void hand_over(Handover& to) const;
  // Whether there is more to hand over than single numbers.
  bool carries_lists() const;
  // Starts from there at t [s] with a fresh memory, and with nothing counted.
  void take_over(const Handover& from, const EngineMemory& fresh, double t, double start_time);
  // Bounds of the motion are kept even where no guard needs them.
  void follow_motion() { follows_motion_ = true; }
  // Whether all steps of the last interval were smooth ones without contacts, and whether it was a single one, of the
  // midpoint rule and without an impact.
  bool flew() const { return flew_; }
  bool flew_once() const { return flew_once_; }
  // One control step, the number `step` of the run, of this length from t [s] on. tau: (nv,) or empty; target: (1,
  // 2 nv) or empty. False: it ended early, see the status.
  bool step_island(long step, double t, double length, const VecX& tau, const MatX& target, const Progress& progress,
                   Recording& recording);
  // undisturbed_steps.cpp: steps that were solved in advance and in which nothing happens are made at once. foresee()
  // tells how many of the next control steps are such ones, at most `most`; of these, pass_foreseen() makes the first
  // `count`, the last of which starts at `last_start` [s]; pass_island() does so for an island (step_island()).
  int foresee(long most);
  const StepsAhead& foreseen() const { return integrator_.ahead(); }
  WorkAccount::FreeWork foreseen_work(int step);
  void pass_foreseen(int count, double last_start);
  void pass_island(int count, long last_step, double last_start, const Progress& progress);
  // Forgets what has been counted in the state since it was last taken, and what the parts have counted.
  void forget_counts();
  void reset_counters();
  // The two parts of reset(): the state, without persistent contacts; and those of the shapes that touch there, or
  // dense steps where they are too many.
  Status start(const VecX& q, const VecX& v, double t);
  void close_contacts_at_start();
  RunState& state() { return state_; }
  Guards& guards() { return guards_; }
  const ContactStep& contact_step() const { return contact_step_; }
  const DenseStep& dense_step() const { return dense_step_; }
  // Whether a guard is closed, within tolerance, or has just opened.
  bool touches(int guard) const { return finder_.touching(guard); }
  Integrator& integrator() { return integrator_; }
  // Its smooth steps are solved side by side with those of other runs from now on.
  void join(SideBySide& company);

  // A run that goes on after restore() has the same digits.
  std::shared_ptr<const Snapshot> save();
  void restore(const Snapshot& snapshot);

 private:
  // The interval of one control step under way [s]; done and remaining add up to length.
  struct Interval {
    double start, length, done, remaining;
    const VecX& tau;
    bool checked = false;         // the state is in range, as its last change was a smooth step
    bool keeps_branches = false;  // the next smooth step has those of the last one, which has ended where one did
    // Of how many steps of at most this length [s] the rest consists; one that is longer by rounding is no further one.
    double parts(double nominal) const { return std::max(1.0, std::ceil(remaining / nominal - 1e-9)); }
  };
  // Of run_auto: the bound on the truncation (0 in advance), the largest one in the interval [m; rad], the longest
  // smooth step that converges, the longest contact step that could be solved, the present length [s], the most stage
  // iterations of a smooth step of the interval, and AutoSteps::after_impact. limited: a smooth step above the bound is
  // given up, the interval with it; too_long: one was, first: as the first part of the interval, so that nothing has
  // been done in it.
  struct Truncation {
    double bound = 0, largest = 0, longest_dt = 0, longest_contact = 0, length = 0;
    long iterations = 0;
    int after_impact = 1;
    bool limited = false, too_long = false, first = false;
  };

  // Functions that return a bool return false where the run has ended; the status of the state then gives the reason.
  // Other meanings are documented with the function.
  bool advance_interval(double start, double length, const VecX& tau, Recording& recording);
  bool advance_free(Interval& interval, long halved, Recording& recording);
  bool take_event(Interval& interval, double h, bool shorter, Recording& recording);
  // Of the step just solved, from the state to q1_, p1_.
  bool solve_again(double h, const VecX& tau);
  StepEnergy step_energy();
  bool solve_smooth_step(double time, double h, const VecX& tau, bool last_try);
  void start_recording(const Progress& progress, Recording& recording);
  void record_node(double t, Recording& recording) { record_node(t, state_.q.data(), state_.p.data(), recording); }
  void record_node(double t, const double* q, const double* p, Recording& recording);
  bool flies_undisturbed() const;
  long pass_undisturbed_steps(long left, long record_every, Recording& recording);
  void record_phase(double time, double dt, StepKind kind, Recording& recording) const;
  void record_segment(double t, double h, const VecX& p1, Recording& recording);
  bool report_progress(double time);
  bool stays_in_range(double time);
  bool end_failed_search(Search outcome, double time);
  bool run_impacts(const Instant& now, Recording& recording);
  bool user_function_failed(double time);
  // What makes the steps without persistent contacts.
  Stepper& free_stepper() {
    return contact_step_.has_fixed_rows() ? static_cast<Stepper&>(contact_step_) : integrator_;
  }
  FreeState free_state(double t) { return free_state(t, options_.dt); }
  FreeState free_state(double t, double dt) { return {free_stepper(), state_.q, state_.p, t, dt}; }
  bool resolve_event(int first, bool stays_closed, const Instant& now, Recording& recording);
  double shortest_nominal_step() const;
  bool allows_persistent_contact() const { return law_->allows_persistent_contact() && !options_.end_at_zeno; }
  void resume_free_motion(double t) { law_->resume(free_state(t), state_.reference); }

  // branch_steps.cpp: where force laws change their branches.
  void count_saturated(bool smooth);
  bool begin_branches(const Interval& interval);
  bool enter_branch(Interval& interval, const VecX& q, const VecX& v, bool moved, Recording& recording);
  bool end_failed_switch(Search outcome, double time);

  // adaptive_step.cpp and snapshot.cpp.
  bool run_adaptive_steps(double end, double origin, const AutoSteps& steps, Recording& recording);
  bool may_be_shortened(double length, long impacts) const;
  bool takes_contact_steps() const;
  void grow_adaptive_step(double h, double largest, double level, long most_iterations);
  double take_plan(const StepPlan& plan, double end, bool persistent);
  double most_steps() const;
  bool end_with_too_many_steps(double time, double h);
  void redo_from(const Snapshot& start, const Recording::Mark& mark, Recording& recording);
  Snapshot snapshot();
  void restore_state(const Snapshot& snapshot);
  void recall(const EngineMemory& memory);

  // held_contacts.cpp: persistent contacts in smooth steps.
  // Whether steps keep more than the constraints: persistent contacts, joint friction.
  bool has_phase() const { return keeps_joint_friction_ || !contact_step_.contacts().empty(); }
  bool may_hold_contacts(double time) const;
  bool is_as_contact_step(double h) const;
  bool leave_to_contact_steps(double time);
  bool shorten_step(double h, double time);
  bool held_step_keeps_energy();
  // Whether the smooth step just solved keeps rows and is to be kept for derivatives.
  bool keeps_held_steps() const { return options_.gradient && integrator_.constraints() != nullptr; }
  void keep_held_step(bool switches);
  void change_contact(int function, double time, const VecX& v, bool moved, Recording& recording);

  // contact_phase.cpp: steps in persistent contact.
  bool advance_contact(Interval& interval, long halved, Recording& recording);
  bool retry_contact_step(double h, double time);
  bool first_contact_change(const Interval& interval, double h, double& alpha, bool& hit, bool& again,
                            Recording& recording);
  void step_past_rounding(int guard);
  bool changes_energy();
  int deepest_pair(const VecX& q, double& gap);
  bool sinks_in(Recording& recording, double time);
  bool sinks_deeper(Recording& recording, double time);
  void record_overlap(int guard, double gap, double time, Recording& recording);
  double potential(const VecX& q);
  bool update_contact_points(const Interval& interval, Recording& recording);
  void keep_contact_step(double share, bool hit, bool cut);
  void accept_contact_step(double time, double h, bool dense, Recording& recording);
  void record_contact_forces(double time, double h, Recording& recording);
  double current_dt() const { return contact_step_.contacts().empty() ? options_.dt : contact_dt(); }
  double contact_dt() const { return options_.dt_contact > 0.0 ? options_.dt_contact : options_.dt; }

  // dense_steps.cpp: dense steps, and the decision between them and located events.
  bool allows_dense_steps() const;
  bool end_violated(int constraint, double time);
  double located_cost() const;
  double points_now() const;
  double share_of_burst() const;
  double allowed_cost(double length) const;
  bool locating_pays(int rows, int points) const;
  bool persistent_contacts_pay() const;
  bool events_accumulate(double cost, double length) const;
  bool dense_steps_go_on() const;
  bool dense_may_end() const;
  void begin_dense_phase();
  void end_dense_phase();
  bool advance_dense(Interval& interval, Recording& recording);
  void keep_dense_step(double time, double share);
  void accept_dense_step(double time, double h, Recording& recording);
  void record_dense_contact(const DenseContact& c, double time, double h, Recording& recording) const;

  bool end(StatusCode code, double time, std::string message, int guard = -1);

  // Whether anything but gravity and springs does work, inputs left aside.
  bool scene_does_work() const;
  bool sequence_loses();

  const Scene* scene_;
  SimulatorOptions options_;
  const ImpactLaw* law_;
  const bool keeps_constraints_;     // keeps_constraints()
  const bool keeps_joint_friction_;  // there is some, in smooth steps
  bool dissipative_, does_work_;  // whether some force dissipates energy; whether any but gravity and springs does work
  RunState state_;
  Integrator integrator_;
  Guards guards_;
  EventFinder finder_;
  ContactStep contact_step_;
  DenseStep dense_step_;
  costs::Steps costs_;
  ImpactSequence sequence_;
  StepPath path_, contact_path_;
  Actuation actuation_;
  Branches branches_;
  ContactModes modes_;
  JoinedSwitches all_switches_;
  SwitchFinder switches_;
  LongSteps long_steps_;
  ZenoDetector zeno_;
  ContactSet contacts_;
  ContactChangeFinder changes_;
  Truncation truncation_;
  Guide* guide_ = nullptr;
  VecX q1_, p1_, v_, v_long_;
  VecX gravity_q_;        // the last configuration whose potential in gravity was found,
  double gravity_ = 0.0;  // and that potential [J]
  bool follows_motion_ = false, flew_ = false, flew_once_ = false;
  bool in_company_ = false;  // whether its smooth steps are solved side by side with those of other runs
  MatX rates_;               // chart rates at the stages of the step just solved
  std::vector<ContactStepRecord> kept_steps_;
  std::vector<DenseStepRecord> kept_dense_steps_;
  std::vector<HeldStepRecord> kept_held_steps_;
  EngineMemory fresh_;       // as it is before any run
  ProgressReports reports_;  // of the present call of advance or run_auto
};

}  // namespace contactvi

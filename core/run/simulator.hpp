// The event loop: smooth steps, events, impacts, and the status a run ends with.
#pragma once

#include <chrono>
#include <functional>
#include <memory>

#include "base/error.hpp"
#include "contact/contact_step.hpp"
#include "event/finder.hpp"
#include "impact/sequence.hpp"
#include "record/recording.hpp"

namespace contactvi {

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
};

// Called about ten times a second with (time [s], impacts so far); false asks the run to stop.
using Progress = std::function<bool(double, long)>;

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
  // Runs for `duration` [s] with steps of equal length between one impact and the next, such that the highest mode of
  // the stage velocities moves nothing by more than `level` [m; rad] per step (Integrator::truncation). Where it does,
  // the steps since the last impact are redone with a shorter length. Every step's end is a node.
  Status run_auto(double duration, double level, const Progress& progress, Recording& recording);

  double time() const { return time_; }
  const VecX& q() const { return q_; }
  const VecX& p() const { return p_; }
  const Scene& scene() const { return *scene_; }
  const SimulatorOptions& options() const { return options_; }
  const StepCounters& step_counters() const { return integrator_.counters; }
  const GuardCounters& guard_counters() const { return guards_.counters; }
  long steps() const { return step_; }
  long impacts() const { return impacts_; }
  long halved() const { return halved_; }
  long rejected() const { return rejected_; }
  const ContactStepCounters& contact_counters() const { return contact_step_.counters; }
  double contact_seconds() const { return contact_seconds_; }
  long saturated() const { return saturated_; }

  // All that the rest of a run depends on: a run that goes on after restore() has the same digits.
  struct Snapshot;
  std::shared_ptr<const Snapshot> save();
  void restore(const Snapshot& snapshot);

 private:
  // Work [J] since the reset: of inputs, servos and wrenches; dissipated by damping; dissipated by joint friction; of
  // driven constraints.
  struct Work {
    double input = 0, damping = 0, joint_friction = 0, driven = 0;
  };
  // The flights of one guard between its impacts [s], from which an accumulation of impacts is recognised.
  struct Bouncing {
    double last_time = 0, last_flight = 0, longest_flight = 0;
    int impacts = 0, shrinking_flights = 0, short_flights = 0;
  };
  // The state that run_auto returns to when it redoes the steps since the last impact.
  struct AdaptiveStart {
    double time, largest_speed;
    ImpactReference reference;
    VecX q, p;
    std::vector<char> touching;
    std::vector<Bouncing> bouncing;
    std::vector<PersistentContact> persistent;
    Recording::Mark mark;
    long impacts, step;
    Work work;
    VecX reactions;
    double node_time;
  };

  // The interval of one control step under way [s]; done and remaining add up to length.
  struct Interval {
    double start, length, done, remaining;
    const VecX& tau;
  };

  // Events and changes of contact at one instant that make no impact: from the first number on rounding of the
  // positions is assumed, at the second one the run ends.
  static constexpr int kStandstill = 3;
  static constexpr int kMaxWithoutProgress = 200;

  // Functions that return a bool return false where the run has ended; status_ then gives the reason. Other meanings
  // are documented with the function.
  bool advance_interval(double start, double length, const VecX& tau, Recording& recording);
  bool advance_free(Interval& interval, long halved, Recording& recording);
  bool solve_smooth_step(double time, double h, const VecX& tau, bool last_try);
  void record_node(double t, Recording& recording);
  void record_segment(double t, double h, const VecX& p1, Recording& recording);
  void halve_step(double h);
  bool report_progress(double time);
  AdaptiveStart adaptive_start(const Recording& recording) const;
  void return_to(const AdaptiveStart& start, Recording& recording);
  bool run_adaptive_steps(double end, double level, Recording& recording);
  bool end_failed_search(Search outcome, double time);
  // actuation.cpp: inputs and servos within their limits, and the work account.
  void set_actuation(const VecX& tau, const MatX& target, long k);
  void limit_actuation();
  double effort_limit(int d) const;
  void apply_servo();
  bool saturate_servos(const StepEquations& step);
  void add_contact_work();
  bool run_impacts(const Instant& now, Recording& recording);
  bool user_function_failed(double time);
  FreeState free_state() { return {integrator_, q_, p_, options_.dt}; }
  bool resolve_event(int first, bool stays_closed, const Instant& at, Recording& recording);
  void find_accumulating_impacts(double time);
  double short_flight_limit(double e) const;
  double shortest_flight() const;
  bool update_bouncing(int first, bool stays, double time, Recording& recording);
  bool allows_persistent_contact() const { return law_->allows_persistent_contact() && !options_.end_at_zeno; }
  void resume_free_motion();

  // contact_phase.cpp and contact_set.cpp: persistent contact.
  bool advance_contact(Interval& interval, Recording& recording);
  bool retry_contact_step(double h, double time);
  bool first_contact_change(const Interval& interval, double h, double& alpha, bool& hit, bool& again,
                            Recording& recording);
  void step_past_rounding(int guard);
  bool gains_energy();
  bool find_release(const VecX& tau, double& alpha, bool& at_start);
  bool find_stick(const VecX& tau, double& alpha);
  bool release_force(const VecX& tau, double alpha, double& value);
  bool remaining_slip(const VecX& tau, double alpha, double& value);
  void accept_contact_step(double time, double h, bool dense, Recording& recording);
  void record_contact_forces(double time, double h, Recording& recording);
  void release_separated(double time, Recording& recording);
  void release_guard(int guard, double time, Recording& recording);
  bool points_may_change(int guard);
  bool update_contact_points(const Interval& interval, Recording& recording);
  void close_contacts(int forced, double time, const VecX& tau, Recording& recording);
  void release_unloaded(int forced, const VecX& tau);
  void close_contacts_at_start();
  PersistentContact make_persistent(const ContactPoint& point, const Contact& contact, const Vec3& slip);
  void update_persistent_guards();
  void record_phase(double time, double dt, bool persistent, Recording& recording) const;
  void record_change(double time, const ContactPoint& point, Change change, double value, Recording& recording) const;
  double current_dt() const { return contact_step_.contacts().empty() ? options_.dt : contact_dt(); }
  double contact_dt() const { return options_.dt_contact > 0.0 ? options_.dt_contact : options_.dt; }

  bool end(StatusCode code, double time, std::string message, int guard = -1);

  const Scene* scene_;
  SimulatorOptions options_;
  Integrator integrator_;
  Guards guards_;
  EventFinder finder_;
  StepPath path_;
  VecX q_, p_, q1_, p1_, v_;
  MatX rates_;  // chart rates at the stages of the step just solved
  double t0_ = 0, time_ = 0;
  double trial_dt_ = 0;    // longest free step to try [s]: shorter than dt after a step that did not converge
  int solved_in_row_ = 0;  // steps of the length trial_dt_ solved one after the other
  // Of run_auto: the bound on the truncation (0 in advance), and the largest one in the interval [m; rad].
  double truncation_bound_ = 0, truncation_ = 0;
  double adaptive_dt_ = 0, longest_dt_ = 0;
  std::chrono::steady_clock::time_point last_report_;
  const Progress* progress_ = nullptr;  // of the present call of advance or run_auto
  double largest_speed_ = 0;            // largest normal speed of a closed contact so far
  long step_ = 0, halved_ = 0, rejected_ = 0, impacts_ = 0;
  std::vector<Bouncing> bouncing_;
  ContactStep contact_step_;
  StepPath contact_path_;
  ImpactSequence sequence_;
  const ImpactLaw* law_;
  ImpactReference reference_;
  bool dissipative_ = false;            // whether some force dissipates energy
  std::vector<char> plastic_;           // per guard: whether its impacts at this event count as plastic
  std::vector<int> persistent_guards_;  // guards with persistent contacts, as guards_ knows them
  std::vector<PersistentContact> previous_contacts_;
  std::vector<int> meeting_guards_;   // guards that may be closed at the start
  std::vector<int> impacted_guards_;  // guards that had an impact at the last event
  // Guard and feature of points that have separated and whose gap is still closed.
  std::vector<std::pair<int, std::int64_t>> separated_;
  std::vector<ChangeRecord> initial_changes_;  // changes of contact made by reset, which the next run records
  double flight_dt_ = 0;                       // longest free step after a short flight [s]; 0: any
  std::vector<ContactPoint> points_;
  std::vector<int> ending_slips_;       // slips that end in the step
  std::vector<int> lost_guards_;        // guards whose points are no longer closed
  int releasing_ = -1, sticking_ = -1;  // contacts that the root searches look at
  VecX forces_;
  double contact_trial_dt_ = 0, contact_seconds_ = 0;
  double kinetic_ = 0;  // kinetic energy at the end of the last contact step [J]
  int contact_solved_in_row_ = 0, changes_without_progress_ = 0, sticks_located_ = 0;
  Status status_;
  VecX tau_, limited_tau_;  // generalized force of the step under way: as given, within the limits
  Servo servo_;
  long saturated_ = 0;  // actuators at their limits, summed over steps
  Work work_;
  bool does_work_ = false;           // whether anything but gravity and springs does work
  VecX reactions_, mean_reactions_;  // impulses of the constraints since the last node; their mean force before it
  double node_time_ = 0;
};

}  // namespace contactvi

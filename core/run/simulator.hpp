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
  int max_iterations = 50;  // sweeps per attempt at a step
  long max_impacts_per_step = 100000;
  int stages = 1;              // s of order 2s
  bool dense = false;          // keep the polynomials of the steps
  double dt_contact = 0.0;     // step while contacts are held [s]; 0: dt
  bool end_at_zeno = false;    // end the run where impacts accumulate or a contact stays closed
  bool stiff_support = false;  // held contacts take part in an impact as rigid supports, not as partners
  int contact_points = 4;      // of a pair, at most
  bool record_contacts = true;
};

// Called now and then with (time, impacts so far); false asks the run to stop.
using Progress = std::function<bool(double, long)>;

class Simulator {
 public:
  Simulator(const Scene& scene, const SimulatorOptions& options);

  // State in engine coordinates. Fails with kPenetration or kNotFinite.
  Status reset(const VecX& q, const VecX& v, double t);
  // steps steps of dt with the generalized force tau (steps x nv, public coordinates, or empty) constant over each, and
  // references of the servos (steps x 2 nv: q_ref, v_ref, or empty: as they were); nodes are recorded every
  // record_every steps. The run may end early: see the status.
  Status advance(long steps, const MatX& tau, const MatX& target, long record_every, const Progress& progress,
                 Recording& recording);
  // Until time + duration with steps of equal length within each smooth arc, such that the highest mode of the stage
  // velocities moves nothing by more than level [m; rad] per step (Integrator::truncation); an arc where it does is
  // redone with a shorter step. Every step's end is a node.
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

  // All that the rest of a run depends on; what comes after restore() has the same digits.
  struct Snapshot;
  std::shared_ptr<const Snapshot> save();
  void restore(const Snapshot& snapshot);

 private:
  // [J] since reset: of inputs, servos and wrenches; what damping took; what the dry friction of joints took; of
  // constraints that move by themselves.
  struct Work {
    double input = 0, damping = 0, joint_friction = 0, drive = 0;
  };
  // What is known of the bouncing of one guard, to tell accumulation from chatter.
  struct Bouncing {
    double last_time = 0, last_flight = 0, longest_flight = 0;
    int hits = 0, contracting = 0, short_hits = 0;
  };
  // What run_auto goes back to.
  struct AdaptiveStart {
    double time, speed_scale;
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

  // An interval on its way: [s], done and remaining add up to length.
  struct Piece {
    double start, length, done, remaining;
    const VecX& tau;
  };

  static constexpr int kStandstill = 3;            // events in place that hit nothing
  static constexpr int kMaxWithoutProgress = 200;  // changes and events in place that hit nothing

  bool interval(double start, double length, const VecX& tau, Recording& recording);
  bool free_piece(Piece& piece, long halved, Recording& recording);
  bool smooth_step(double time, double h, const VecX& tau, bool last_try);
  void record_node(double t, Recording& recording);
  void record_segment(double t, double h, const VecX& p1, Recording& recording);
  void halve(double h);
  bool report(double time);
  AdaptiveStart adaptive_start(const Recording& recording) const;
  void go_back(const AdaptiveStart& arc, Recording& recording);
  bool run_adaptive_steps(double end, double level, Recording& recording);
  bool search_failed(Search outcome, double time);
  // What pushes in the next step (drive.cpp): tau and the servos within their limits.
  void set_actuation(const VecX& tau, const MatX& target, long k);
  void limit_actuation();
  double most_effort(int d) const;
  void apply_servo();
  bool exceeds_effort(const Integrator& integrator);
  void count_contact_work();
  bool run_impacts(const Instant& now, Recording& recording);
  bool user_failed(double time);
  FreeState free_state() { return {integrator_, q_, p_, options_.dt}; }
  bool resolve_event(int first, bool stays_closed, const Instant& at, Recording& recording);
  void find_accumulating(double time);
  double short_flight(double e) const;
  double shortest_flight() const;
  bool judge_accumulation(int first, bool stays, double time, Recording& recording);
  bool holds() const { return law_->allows_persistent_contact() && !options_.end_at_zeno; }
  void reanchor();

  // Lasting contact (lasting.cpp, contact_book.cpp).
  bool contact_piece(Piece& piece, Recording& recording);
  bool contact_step_failed(double h, double time);
  bool first_change(const Piece& piece, double h, double& alpha, bool& hit, bool& again, Recording& recording);
  void step_past(int guard);
  bool gains_energy();
  bool find_release(const VecX& tau, double& alpha, bool& at_start);
  bool find_stick(const VecX& tau, double& alpha);
  bool release_value(const VecX& tau, double alpha, double& value);
  bool stick_value(const VecX& tau, double alpha, double& value);
  void take_contact_step(double time, double h, bool dense, Recording& recording);
  void record_contacts_of_step(double time, double h, Recording& recording);
  void drop_leaving(double time, Recording& recording);
  void let_go(int guard, double time, Recording& recording);
  bool points_may_change(int guard);
  bool refresh_points(const Piece& piece, Recording& recording);
  void hold_closed(int forced, double time, const VecX& tau, Recording& recording);
  void leave_unloaded(int forced, const VecX& tau);
  void hold_at_start();
  PersistentContact make_persistent(const ContactPoint& point, const Contact& contact, const Vec3& slip);
  void sync_persistent();
  void note_phase(double time, double dt, bool persistent, Recording& recording) const;
  void note(double time, const ContactPoint& point, Change change, double value, Recording& recording) const;
  double present_dt() const { return contact_step_.contacts().empty() ? options_.dt : contact_dt(); }
  double contact_dt() const { return options_.dt_contact > 0.0 ? options_.dt_contact : options_.dt; }

  bool end(StatusCode code, double time, std::string message, int guard = -1);

  const Scene* scene_;
  SimulatorOptions options_;
  Integrator integrator_;
  Guards guards_;
  EventFinder finder_;
  StepPath path_;
  VecX q_, p_, q1_, p1_, v_;
  MatX rates_;  // of the step just solved, while it may be needed
  double t0_ = 0, time_ = 0;
  double trial_ = 0;  // length of the next step to try: shorter than dt after steps that did not converge
  int easy_ = 0;      // steps of that length solved in a row
  double level_ = 0, truncation_ = 0;  // of run_auto: bound, largest of the interval
  double adaptive_h_ = 0, longest_h_ = 0;
  std::chrono::steady_clock::time_point reported_;
  const Progress* progress_ = nullptr;  // of the call under way
  double speed_scale_ = 0;              // largest closing speed of a closed contact so far
  long step_ = 0, halved_ = 0, rejected_ = 0, impacts_ = 0;
  std::vector<Bouncing> bouncing_;
  ContactStep contact_step_;
  StepPath contact_path_;
  ImpactSequence sequence_;
  const ImpactLaw* law_;
  ImpactReference reference_;
  bool dissipative_ = false;            // whether forces take energy
  std::vector<char> plastic_;           // guards whose impacts of this event count as plastic
  std::vector<int> persistent_guards_;  // that guards_ knows to be held
  std::vector<PersistentContact> kept_;
  std::vector<int> hit_;  // guards of the last event
  std::vector<std::pair<int, std::int64_t>>
      separated_;                    // guard and feature of points that have left and are still closed
  std::vector<ChangeRecord> begun_;  // by reset, not recorded yet
  double flight_trial_ = 0;          // longest free step after a short flight; 0: any
  std::vector<ContactPoint> points_;
  std::vector<int> slip_ends_;          // that are looked for in the step
  std::vector<int> lost_;               // guards whose points are no longer closed
  int releasing_ = -1, sticking_ = -1;  // contacts sought by the root searches
  VecX forces_;
  double contact_trial_ = 0, contact_seconds_ = 0;
  double kinetic_ = 0;  // at the end of the last held step [J]
  int contact_easy_ = 0, without_progress_ = 0, sticks_located_ = 0;
  Status status_;
  VecX tau_, force_;  // of the step under way: as given, within the limits
  Servo servo_;
  long saturated_ = 0;  // joints at their limits, summed over steps
  Work work_;
  bool accounts_ = false;            // whether anything does work
  VecX reactions_, mean_reactions_;  // impulses of the constraints since the last node; their mean force before it
  double node_time_ = 0;
};

}  // namespace contactvi

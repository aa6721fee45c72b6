// One island: static trees that are advanced together, by an engine of their own on the scene restricted to them.
#pragma once

#include <memory>

#include "model/static_trees.hpp"
#include "run/island_graph.hpp"
#include "run/simulator.hpp"

namespace contactvi {

// What a static tree carries while it changes islands, and what guards between trees of different islands remember. A
// guard between two trees is kept with the first one. Numbers of the whole scene.
struct LooseState {
  StepControl control;
  double largest_speed = 0;
  ContactStepsUntil contact_steps;
  std::vector<PersistentContact> contacts;
  std::vector<int> touching, exempt;
  std::vector<SeparatedPoint> separated;
  std::vector<Flights::Entry> flights;
  DensePhase dense;
  // Of the last dense step; change: dof and change of its velocity.
  std::vector<DenseImpulse> impulses;
  std::vector<int> closed;
  std::vector<std::pair<int, double>> change;
  double change_h = 1.0;
};

// For how many steps, one after the other, an island has been at rest, and where.
struct Rest {
  // Steps before it sleeps. What leaves an unstable equilibrium slowly has come further in them than in the first one.
  static constexpr int kSteps = 32;
  // How far a point of a body may be from where it was at the first of them, over the larger of 1 and the largest
  // coordinate: two spacings of the doubles there. A turn counts by what it moves the body's points.
  static constexpr double kStill = 4.5e-16;
  // The same after dense steps [m]: what they leave of the gaps at rest adds up.
  static constexpr double kStillDense = kSteps * DenseStep::kGapSolvedAtRest;
  static constexpr double kMoves = 1e-9;  // [m] this is no rest at coordinates below 2000 km, and not looked at further

  int steps = 0;
  VecX q;  // at the end of the first of them, once there are two

  // A step has ended at this configuration, which began at those entries of `before`; levers: how far a change of a
  // coordinate by 1 moves points, at most 1 [m]; quiet: nothing but rest happened in it; dense: it was of dense steps.
  void count(const VecX& before, const std::vector<int>& entries, const VecX& now, const VecX& levers, bool quiet,
             bool dense);
  // As this, of numbers of the island; nothing but rest happened.
  void count_undisturbed(const double* before, const double* now, const VecX& levers);

 private:
  template <class Before>
  void count_with(Before before, const double* now, const VecX& levers, bool quiet, double most);
};

class Island {
 public:
  Island(const Scene& whole, const StaticTrees& all, std::vector<int> trees, const SimulatorOptions& options);
  // The island of all trees, which uses this engine.
  Island(const Scene& whole, const StaticTrees& all, std::vector<int> trees, Simulator& engine);
  Island(const Island&) = delete;
  Island& operator=(const Island&) = delete;

  const std::vector<int>& trees() const { return trees_; }
  const SubScene& numbers() const { return *numbers_; }
  Simulator& engine() { return *engine_; }
  Recording& recording() { return recording_; }
  // Whether the last call of step() ended before the end of the interval.
  bool ended_early() const { return !ok_; }

  // Takes its trees over at (q, p) of the whole scene, t [s].
  void form(const VecX& q, const VecX& p, std::vector<LooseState>& loose, std::vector<JointFriction>& friction,
            double t, double start_time);
  // Hands its trees over as they are, or as they were before the last step.
  void dissolve(std::vector<LooseState>& loose, std::vector<JointFriction>& friction);
  void undo(std::vector<LooseState>& loose, std::vector<JointFriction>& friction);

  // One control step from the configuration `before`, while it is not asleep; tau, target: of the whole scene, or
  // empty.
  void step(const VecX& before, long step, double t, double length, const VecX& tau, const VecX& q_ref,
            const VecX& v_ref, const Progress& progress);
  // undisturbed_steps.cpp: steps that were solved in advance and in which nothing happens are made at once, as
  // Simulator::foresee tells and pass_foreseen makes them. reference_intervals(): as which one of them, in the graph,
  // an interval counts.
  int foresee(long most, const IslandGraph& graph);
  double reference_intervals(int interval) const { return engine_->guards().steps_in(interval) * share_; }
  void gather_foreseen(int step, VecX& q, VecX& p) const;
  void pass_foreseen(int count, long last_step, double last_start, const Progress& progress);
  // Whether the last steps have moved nothing by more than rounding, so that it repeats the last one until something
  // changes: its trees, or its inputs.
  bool asleep() const { return rest_.steps >= Rest::kSteps; }
  // Step `step` of this length [s], the last one that it has made, has put it to sleep: it is passed over from now on.
  void fall_asleep(long step, double length);
  // Counts what it would have counted in the steps before `step`, which it has slept through.
  void settle(long step);
  void wake(long step) {
    settle(step);
    rest_.steps = 0;
    passed_over_ = false;
  }
  bool passed_over() const { return passed_over_; }
  // Asleep: mean forces of its constraints; empty where it has none.
  const VecX& mean_reactions() const { return mean_reactions_; }
  const Rest& rest() const { return rest_; }
  // Goes back to having repeated a step whose record is this.
  void restore_rest(const Rest& rest, const Recording& record, const VecX& mean_reactions, const VecX& tau,
                    const MatX& target, const std::vector<double>& turns, long step);
  // How far what flies has turned in the last step [rad].
  std::vector<double> turns() const;
  const VecX& tau() const { return tau_; }
  const MatX& target() const { return target_; }
  // Tells the graph how far it has moved in that step.
  void measure(IslandGraph& graph);
  // Tells it how far each of its geometries has moved so far, and in that step.
  void tell_motion(IslandGraph& graph) const;
  // Tells it where what flies will be carried in an interval of this length [s] if it goes on as it is.
  void tell_expected(double length, IslandGraph& graph) const;
  // From here on its geometries have moved as far as the graph knows.
  void join_graph(const IslandGraph& graph);
  // Whether a state of it has to obey constraints.
  bool constrained() const { return !numbers_->constraint_rows.empty(); }
  // Enters the state that it had a time `part` [s] after the start t [s] of the last step in that of the whole scene,
  // which was (q0, p0) there.
  void gather_at(const VecX& q0, const VecX& p0, long step, double t, double part, const Progress& progress, VecX& q,
                 VecX& p);
  // Enters its state in that of the whole scene.
  void gather(VecX& q, VecX& p) const;
  // Calls join(tree, tree) for those that a contact or a guard that touches keeps together.
  template <class Join>
  void each_bond(Join join) const;

  long last_used = 0;  // the step in which it was in use, for the pool

 private:
  void begin(const Scene& whole, const StaticTrees& all);
  void find_share(const IslandGraph& graph);
  void find_bases(const StaticTrees& all);
  void find_straight(const VecX& before, double t, double length);
  void forget_straight() {
    for (Base& base : bases_) {
      base.straight = false;
      base.bends.clear();
      base.turn = 0.0;
    }
  }
  void tell_motion_of(int k, IslandGraph& graph) const;
  double motion(int k) const { return asleep() ? 0.0 : engine_->guards().motion_since(k); }
  void take_state(const VecX& q, const VecX& p, Handover& to) const;
  bool set_inputs(const VecX& tau, const VecX& q_ref, const VecX& v_ref);
  void count_rest(const VecX& before);
  template <class List, class GuardOf, class Put>
  void take(List& list, GuardOf guard_of, Put put) const;
  void take_dense(std::vector<LooseState>& loose);
  void file(const Handover& from, std::vector<LooseState>& loose, std::vector<JointFriction>& friction) const;
  void number_bodies(ContactPoint& point, bool into) const;
  int local_guard(int guard) const;

  std::vector<int> trees_;
  std::unique_ptr<SubScene> numbers_;
  std::unique_ptr<Simulator> own_;
  Simulator* engine_;
  std::vector<std::pair<int, int>> guard_trees_;  // of its guards
  std::vector<int> dof_tree_;                     // of its dofs
  VecX levers_;                                   // of its coordinates; see Rest
  EngineMemory fresh_;
  Handover before_, handover_;
  Recording recording_;
  std::vector<double> offset_;  // of the graph's odometer of each geometry from that of the engine [m]
  // What is carried by a translation of its own: the place of that in q, and where it was carried in the last step
  // along a straight line, if it was [m, world]. Of each geometry the number of its base, -1: none.
  struct Base {
    int iq, iv, tree;
    Mat3 axes;
    int turning;  // of a rigid body that turns besides: the place of its quaternion, else -1
    double mass;  // of a rigid body on which gravity alone acts, else 0
    Vec3 along;
    std::vector<GeometryPaths::Bend> bends;  // where impacts turned it
    double path;                             // length of that line [m]
    double turn;                             // about so much [rad]
    bool straight;
  };
  std::vector<Base> bases_;
  std::vector<int> base_of_;
  std::vector<char> only_translates_;  // whether it is a ball about a point of the base
  double bow_ = 0.0;                   // see GeometryPaths::set
  // How many reference intervals of the graph a reference step of the engine's guards is, and of which of these.
  double share_ = 0.0;
  long share_span_ = -1, share_room_ = -1;
  VecX tau_;
  MatX target_;
  bool ok_ = true;
  bool depends_on_time_ = false;  // some force or constraint is a function of time
  Rest rest_;
  bool passed_over_ = false;
  long settled_ = 0;  // passed over: the steps before this one are counted
  VecX mean_reactions_;
};

template <class Join>
void Island::each_bond(Join join) const {
  if (trees_.size() < 2) return;
  const auto bind = [&](int guard) { join(guard_trees_[guard].first, guard_trees_[guard].second); };
  for (const PersistentContact& contact : engine_->contact_step().contacts()) bind(contact.point.guard);
  for (const DenseImpulse& impulse : engine_->dense_step().memory().impulses) bind(impulse.guard);
  for (int guard : engine_->dense_step().memory().closed) bind(guard);
  for (int g = 0; g < static_cast<int>(guard_trees_.size()); ++g)
    if (engine_->touches(g)) bind(g);
  for (const SeparatedPoint& point : std::as_const(*engine_).state().separated) bind(point.guard);
}

}  // namespace contactvi

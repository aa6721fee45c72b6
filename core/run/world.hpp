// A scene advanced island by island: static trees that touch or may meet in an interval form an island, and every
// island is advanced over the interval by an engine of its own. What happens in an island, to the last bit, does not
// depend on the others.
//
// An interval costs what happens in it: islands that lie still are passed over until something meets them or an input
// of theirs changes.
//
// An island assumes that its trees meet none of the others in the interval. Where one has moved further than that, the
// islands that it may have met become one, and the interval is done again from its start.
#pragma once

#include <atomic>
#include <map>
#include <memory>

#include "base/worker_threads.hpp"
#include "run/island.hpp"
#include "run/island_graph.hpp"
#include "run/side_by_side.hpp"
#include "run/still_islands.hpp"

namespace contactvi {

struct SavedWorld;

class World {
 public:
  World(const Scene& scene, const SimulatorOptions& options);
  World(const World&) = delete;
  World& operator=(const World&) = delete;

  // From now on its smooth steps are solved side by side with those of other runs.
  void join(SideBySide& company);

  // As those of Simulator, which they are where the scene has one static tree.
  Status reset(const VecX& q, const VecX& v, double t);
  Status advance(long steps, const MatX& tau, const MatX& target, long record_every, const Progress& progress,
                 Recording& recording);
  // As that of Simulator, where all trees are advanced together.
  void follow(Guide* guide) { whole_.follow(guide); }
  void keep_problems(ProblemLog* log) { whole_.keep_problems(log); }
  // Advances all trees together from then on.
  Status run_auto(double duration, const AutoSteps& steps, const Progress& progress, Recording& recording);

  double time() const { return state().time; }
  const VecX& q() const { return state().q; }
  const VecX& p() const { return state().p; }
  const RunState& state() const { return divided_ ? state_ : std::as_const(whole_).state(); }
  const Scene& scene() const { return *scene_; }
  const SimulatorOptions& options() const { return options_; }
  // As those of Simulator: complete where all trees are advanced together, as they are with dense polynomials.
  std::vector<ContactStepRecord> take_contact_steps() { return whole_.take_contact_steps(); }
  std::vector<HeldStepRecord> take_held_steps() { return whole_.take_held_steps(); }
  std::vector<DenseStepRecord> take_dense_steps() { return whole_.take_dense_steps(); }
  std::vector<ImpactBlockRecord> take_impact_blocks() { return whole_.take_impact_blocks(); }
  // Of the engine of all trees, for the mass matrix at any configuration.
  StepEquations& equations() { return whole_.integrator(); }
  // Summed over the engines.
  EngineCounters counters() const;
  // Islands now; 0 where all trees are advanced together.
  int islands() const { return divided_ ? count_ : 0; }

  std::shared_ptr<const SavedWorld> save();
  void restore(const SavedWorld& saved);

 private:
  // The kinds of entries that islands record, merged by time.
  struct Entry {
    double time;
    Island* island;
    std::size_t row;
  };

  bool may_divide() const;
  void divide(const VecX& v);
  void leave_islands();
  void unite();
  Island& island_of(const std::vector<int>& trees);
  void forget_unused();
  void regroup(double t);
  template <class Call>
  void each_island(Call call) const;
  bool all_alone() const { return static_cast<int>(awake_.size()) == trees_.count(); }
  std::vector<std::vector<int>> changed_sets();
  void replace_islands(double t, bool undo);
  void set_awake(std::vector<Island*> awake);
  void find_still();
  void let_sleep();
  using InputRow = Eigen::Ref<const Eigen::RowVectorXd, 0, Eigen::InnerStride<>>;
  void set_input(const InputRow& now, VecX& input);
  void run(Island& island, double length);
  void run_all(double length);
  void run_interval(double length);
  void join_met(double t);
  void tell_motion();
  void find_motion();
  bool end_early(double length);
  long pass_undisturbed_intervals(long left, long record_every, Recording& recording);
  void set_inputs(const MatX& tau, const MatX& target, long k);
  void accept(double t, double length, Recording& recording);
  template <class Count, class Time, class Put>
  void merge(Count count, Time time, Put put);
  void merge_phases(double t, Recording& recording);
  void merge_recordings(double t, double length, Recording& recording);
  void add_impact(const Entry& entry, double t, double length, Recording& recording);
  void record_node(Recording& recording);
  bool ask(double time, long impacts);
  bool report_progress();

  const Scene* scene_;
  SimulatorOptions options_;
  Simulator whole_;
  StaticTrees trees_;
  bool divided_ = false;
  IslandGraph graph_;
  RunState state_;  // of all islands together
  std::vector<LooseState> loose_;
  std::vector<JointFriction> joint_friction_;
  // Every island that has been in use, until it is forgotten; that of each tree now; those that do not lie still, in
  // the order of their first trees.
  std::map<std::vector<int>, std::unique_ptr<Island>> pool_;
  std::vector<Island*> island_of_tree_, awake_, to_run_;
  int count_ = 0, awake_trees_ = 0;  // of islands now; of the trees of awake_
  StillIslands still_;
  bool still_changed_ = false;  // who lies still is not yet known to still_
  // Of all trees while none is advanced; later of those that are awake anew in each interval, while those of the others
  // stay.
  DisjointSets sets_;
  SideBySide* company_ = nullptr;
  EngineCounters forgotten_;  // of islands that are in the pool no more
  VecX tau_, q_ref_, v_ref_;
  VecX q1_, p1_;  // the state after the interval; of what lies still at any time
  std::vector<Entry> entries_;
  std::vector<double> foreseen_;  // of intervals in which nothing happens: as how many reference intervals they count
  ProgressReports reports_;
  Progress island_progress_;
  // The threads that advance islands besides the caller's, who alone is asked; the others hear that it has ended the
  // run.
  std::unique_ptr<WorkerThreads> helpers_;
  std::atomic<bool> stopped_{false};
};

template <class Call>
void World::each_island(Call call) const {
  for (int tree = 0; tree < trees_.count(); ++tree) {
    Island* island = island_of_tree_[tree];
    if (island != nullptr && island->trees()[0] == tree) call(*island);
  }
}

}  // namespace contactvi

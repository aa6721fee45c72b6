// Many runs with steps of one length, made in several threads.
//
// Every run under way has an engine of its own, which is what a new one is when the run begins: what happens in a run,
// to the last bit, depends neither on the number of threads nor on the runs before it. The threads take the next run
// from a counter, and results stand where their starts stand.
#pragma once

#include <atomic>
#include <exception>
#include <functional>
#include <memory>
#include <vector>

#include "model/scene_changes.hpp"
#include "run/world.hpp"

namespace contactvi {

// A start in engine coordinates, and the inputs of its run as in Simulator::advance; runs may share them. A run whose
// row of changes is not empty has a copy of the scene with these numbers.
struct BatchStart {
  const Scene* scene;
  VecX q, v;
  std::shared_ptr<const MatX> tau, target;
  VecX changes;
};

// What is kept of a run besides its end: nothing, the states at its nodes, or all that was recorded.
enum class BatchKeep : int { kEnds = 0, kNodes = 1, kRuns = 2 };

struct BatchOutcome {
  bool made = false;           // it was run to its end, or to a failure
  std::exception_ptr failure;  // what the engine refused, or a fault of the program
  bool massless = false;       // not made, because velocities do not come back from their momenta at the start
  Status start, status;        // of the start, and of the run that began there
  double start_time = 0.0;     // [s]
  VecX start_p;                // momentum, engine coordinates
  // Times [s] and public q (N, nq), v (N, nv) at the nodes, row after row; without nodes those at the end.
  std::vector<double> t, q, v;
  long impacts = 0, dense_steps = 0;
  double seconds = 0.0;  // of the thread; those that are made side by side share it
  // Of runs that are kept.
  RunState state;
  EngineCounters counters;
  Recording recording;
  std::vector<ContactStepRecord> contact_steps;
  std::vector<ImpactBlockRecord> impact_blocks;
  std::vector<DenseStepRecord> kept_dense_steps;
  std::vector<HeldStepRecord> held_steps;
};

class Batch {
 public:
  // most_lost: of a velocity of size 1 that becomes a momentum and a velocity again.
  Batch(const SimulatorOptions& options, long steps, long record_every, BatchKeep keep, double most_lost)
      : options_(options), steps_(steps), record_every_(record_every), keep_(keep), most_lost_(most_lost) {}

  // What the numbers of the rows of changes are.
  void set_changes(SceneChanges changes) { changes_ = std::move(changes); }
  const SceneChanges& changes() const { return changes_; }
  // All runs go on from a state of their scene, which has no changes, instead of their starts.
  void set_start(std::shared_ptr<const SavedWorld> saved) { saved_ = std::move(saved); }

  void add(BatchStart start) { starts_.push_back(std::move(start)); }
  // Makes all runs. `poll` is called in this thread with the number of runs made, about twenty times a second; where it
  // returns false the runs end: those under way with the status kInterrupted, and others are not made.
  void run(int threads, const std::function<bool(std::size_t)>& poll);

  std::size_t size() const { return starts_.size(); }
  // Of the last call of run().
  int threads() const { return threads_; }
  const BatchStart& start(std::size_t k) const { return starts_[k]; }
  BatchOutcome& outcome(std::size_t k) { return outcomes_[k]; }
  const SimulatorOptions& options() const { return options_; }
  // Stage iterations that runs have made together, each counted once for every run in it.
  long shared_iterations() const { return shared_; }

 private:
  void take_runs_side_by_side(int threads);
  // What makes runs of one scene, one after the other.
  struct Maker {
    Maker(const Scene& scene, const SimulatorOptions& options, SideBySide* company);
    const Scene* scene;
    Integrator integrator;
    NodeLanes nodes;
    World world;
  };
  void take_runs(SideBySide* company);
  void make(const BatchStart& start, SideBySide* company, std::unique_ptr<Maker>& maker, BatchOutcome& outcome);
  void make(Maker& maker, const BatchStart& start, SideBySide* company, BatchOutcome& outcome);
  void begin(const BatchStart& start, World& world, BatchOutcome& outcome) const;
  void keep_nodes(Maker& maker, const BatchStart& start, const Recording& recording, BatchOutcome& outcome) const;
  bool is_node(double t) const;

  SimulatorOptions options_;
  long steps_, record_every_;
  BatchKeep keep_;
  double most_lost_;
  SceneChanges changes_;
  std::shared_ptr<const SavedWorld> saved_;
  std::vector<BatchStart> starts_;
  std::vector<BatchOutcome> outcomes_;
  int threads_ = 1;
  std::atomic<std::size_t> next_{0}, made_{0};
  std::atomic<long> shared_{0};
  std::atomic<bool> stop_{false};
};

}  // namespace contactvi

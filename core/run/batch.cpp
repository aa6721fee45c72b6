#include "run/batch.hpp"

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <optional>
#include <thread>

#include "base/worker_threads.hpp"
#include "model/coordinates.hpp"
#include "step/integrator.hpp"
#include "step/lost_velocity.hpp"
#include "step/node_lanes.hpp"

namespace contactvi {

namespace {

constexpr std::chrono::milliseconds kPollPeriod(50);

// Appends states to an outcome, with the velocities that belong to their momenta.
class States {
 public:
  States(const Tree& tree, BatchOutcome& to) : tree_(tree), to_(to) {
    if (!tree.followers.empty()) equations_.emplace(tree, 1, 1e-12, 1);
  }

  void add(double t, const VecX& q, VecX p) {
    // By way of public momenta, as the velocities of single runs are computed: equal bits.
    if (equations_) equations_->complete_momentum(q, p);
    engine_to_public(tree_, q, p);
    public_to_engine(tree_, q, p);
    to_.t.push_back(t);
    to_.q.insert(to_.q.end(), q.data(), q.data() + tree_.nq);
    to_.v.insert(to_.v.end(), p.data(), p.data() + tree_.nv);
  }
  // After the last one; lanes: of the tree.
  void find_velocities(NodeLanes& lanes) {
    const auto count = static_cast<Eigen::Index>(to_.t.size());
    const Eigen::Map<const MatX> q(to_.q.data(), tree_.nq, count);
    Eigen::Map<MatX> v(to_.v.data(), tree_.nv, count);
    lanes.find_velocities(q, v);
    for (Eigen::Index k = 0; k < count; ++k) engine_to_public(tree_, q.col(k), v.col(k));
  }

 private:
  const Tree& tree_;
  BatchOutcome& to_;
  std::optional<Integrator> equations_;  // where joints are coupled
};

}  // namespace

void Batch::run(int threads, const std::function<bool(std::size_t)>& poll) {
  outcomes_ = std::vector<BatchOutcome>(starts_.size());
  threads_ = threads;
  next_ = made_ = 0;
  shared_ = 0;
  stop_ = false;
  std::mutex mutex;
  std::condition_variable ended;
  std::size_t done = 0;
  const int most = static_cast<int>(std::min<std::size_t>(threads, starts_.size()));
  const auto work = [&] {
    take_runs_side_by_side(most);
    const std::lock_guard lock(mutex);
    ++done;
    ended.notify_one();
  };
  std::vector<std::thread> workers = start_threads(most, work);
  if (workers.empty()) take_runs_side_by_side(1);  // the process may start no threads
  std::unique_lock lock(mutex);
  while (!ended.wait_for(lock, kPollPeriod, [&] { return done == workers.size(); })) {
    lock.unlock();
    if (!stop_ && !poll(made_)) stop_ = true;
    lock.lock();
  }
  lock.unlock();
  for (std::thread& worker : workers) worker.join();
}

// In one of so many threads, none of which takes runs that another one could make at the same time.
void Batch::take_runs_side_by_side(int threads) {
  const std::size_t share = (starts_.size() + threads - 1) / std::max(1, threads);
  const int stacks = static_cast<int>(std::min<std::size_t>(SideBySide::most_runs(options_.stages), share));
  if (stacks <= 1) return take_runs(nullptr);
  SideBySide company;
  if (!company.run(stacks, [&] { take_runs(&company); })) return take_runs(nullptr);
  shared_ += company.shared_iterations();
}

Batch::Maker::Maker(const Scene& scene, const SimulatorOptions& options, SideBySide* company)
    : scene(&scene), integrator(scene.tree, 1, 1e-12, 1), nodes(scene.tree), world(scene, options) {
  if (company != nullptr) world.join(*company);
}

void Batch::take_runs(SideBySide* company) {
  std::unique_ptr<Maker> maker;
  for (std::size_t k = next_++; k < starts_.size() && !stop_; k = next_++) {
    try {
      make(starts_[k], company, maker, outcomes_[k]);
    } catch (...) {
      maker.reset();
      outcomes_[k].failure = std::current_exception();
    }
    outcomes_[k].made = true;
    ++made_;
  }
}

void Batch::make(const BatchStart& start, SideBySide* company, std::unique_ptr<Maker>& maker, BatchOutcome& outcome) {
  if (start.changes.size() == 0) {
    if (!maker || maker->scene != start.scene) maker = std::make_unique<Maker>(*start.scene, options_, company);
    return make(*maker, start, company, outcome);
  }
  Scene changed = *start.scene;
  changes_.apply(start.changes, changed);
  Maker own(changed, options_, company);
  make(own, start, company, outcome);
}

void Batch::make(Maker& maker, const BatchStart& start, SideBySide* company, BatchOutcome& outcome) {
  World& world = maker.world;
  outcome.massless = !(lost_velocity(maker.integrator, start.q).share <= most_lost_);
  if (outcome.massless) return;
  begin(start, world, outcome);
  Recording recording;
  if (outcome.start.ok()) {
    static const MatX none;
    const MatX& tau = start.tau ? *start.tau : none;
    const MatX& target = start.target ? *start.target : none;
    const Progress progress = [this](double, long) { return !stop_; };
    const auto first = std::chrono::steady_clock::now();
    const long record_every = keep_ == BatchKeep::kEnds ? std::max(1L, steps_) : record_every_;
    outcome.status = world.advance(steps_, tau, target, record_every, progress, recording);
    const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - first;
    outcome.seconds = taken.count() / (company != nullptr ? company->stacks() : 1);
  }
  keep_nodes(maker, start, recording, outcome);
  outcome.impacts = static_cast<long>(recording.impacts.size());
  outcome.dense_steps = world.state().dense_steps;
  if (keep_ != BatchKeep::kRuns) return;
  outcome.state = world.state();
  outcome.counters = world.counters();
  outcome.recording = std::move(recording);
  outcome.contact_steps = world.take_contact_steps();
  outcome.impact_blocks = world.take_impact_blocks();
  outcome.kept_dense_steps = world.take_dense_steps();
  outcome.held_steps = world.take_held_steps();
}

void Batch::begin(const BatchStart& start, World& world, BatchOutcome& outcome) const {
  if (saved_) {
    world.restore(*saved_);
    outcome.start_time = outcome.status.time = world.time();
  } else {
    outcome.start = outcome.status = world.reset(start.q, start.v, 0.0);
  }
  outcome.start_p = world.p();
}

// Whether a node of the engine is one of the run: every record_every steps.
bool Batch::is_node(double t) const {
  return record_every_ == 1 || std::fmod(std::nearbyint(t / options_.dt), static_cast<double>(record_every_)) == 0.0;
}

void Batch::keep_nodes(Maker& maker, const BatchStart& start, const Recording& recording, BatchOutcome& outcome) const {
  const Tree& tree = maker.scene->tree;
  const World& world = maker.world;
  States states(tree, outcome);
  if (!outcome.start.ok()) {
    states.add(0.0, start.q, outcome.start_p);
  } else if (keep_ == BatchKeep::kEnds) {
    states.add(outcome.status.time, world.q(), world.p());
  } else {
    states.add(outcome.start_time, start.q, outcome.start_p);
    for (std::size_t k = 0; k < recording.t.size(); ++k) {
      if (recording.t[k] <= outcome.t.back() || !is_node(recording.t[k])) continue;
      states.add(recording.t[k], Eigen::Map<const VecX>(recording.q.data() + k * tree.nq, tree.nq),
                 Eigen::Map<const VecX>(recording.p.data() + k * tree.nv, tree.nv));
    }
    if (outcome.status.time > outcome.t.back()) states.add(outcome.status.time, world.q(), world.p());
  }
  states.find_velocities(maker.nodes);
}

}  // namespace contactvi

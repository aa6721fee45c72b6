#include "run/world.hpp"

#include <algorithm>
#include <cmath>

#include "impact/impact_maps.hpp"
#include "run/saved_world.hpp"
#include "step/path.hpp"

namespace contactvi {

namespace {
constexpr std::size_t kKept = 64;  // islands that are kept for later, beside two for each tree

std::vector<int> numbers_up_to(int count) {
  std::vector<int> list(count);
  for (int i = 0; i < count; ++i) list[i] = i;
  return list;
}

void add(const Simulator& engine, EngineCounters& sum) {
  sum_up({engine.step_counters(), engine.guard_counters(), engine.contact_counters(), engine.dense_counters()}, sum);
}

}  // namespace

World::World(const Scene& scene, const SimulatorOptions& options)
    : scene_(&scene),
      options_(options),
      whole_(scene, options),
      trees_(scene),
      graph_(trees_, whole_.guards()),
      loose_(trees_.count()),
      joint_friction_(scene.tree.elements.friction_dofs.size()),
      island_of_tree_(trees_.count(), nullptr) {
  // Now, while the memory of its engine is fresh.
  if (may_divide()) island_of(numbers_up_to(trees_.count()));
  island_progress_ = [this](double t, long impacts) {
    return WorkerThreads::in_helper() ? !stopped_ : ask(t, state_.impacts + impacts);
  };
  // Errors of the user's functions are kept by the thread in which they happen.
  if (options.threads > 1 && may_divide() && scene.tree.elements.functions == nullptr)
    helpers_ = std::make_unique<WorkerThreads>(options.threads - 1);
}

// Whether islands are advanced one by one: an impulse that solves an equation of the whole step belongs to the whole
// world, and so do the polynomials of whole steps. Trees that have no events gain nothing from it.
bool World::may_divide() const {
  return options_.islands && trees_.count() > 1 && scene_->guard_count() > 0 &&
         !impact_law(options_.impact).implicit() && !options_.dense;
}

void World::join(SideBySide& company) {
  company_ = &company;
  whole_.join(company);
  for (auto& [trees, island] : pool_)
    if (&island->engine() != &whole_) island->engine().join(company);
}

Status World::reset(const VecX& q, const VecX& v, double t) {
  divided_ = false;
  const VecX q0 = q, v0 = v;  // the arguments may be those of the state
  whole_.renew();
  for (auto& [trees, island] : pool_) island->engine().forget_inputs();
  if (!may_divide()) return whole_.reset(q0, v0, t);
  const Status status = whole_.start(q0, v0, t);
  if (status.ok()) divide(v0);
  return status;
}

// From the state of the whole engine to islands. v: velocities at that state.
void World::divide(const VecX& v) {
  const RunState& from = std::as_const(whole_).state();
  state_ = from;
  state_.control.halved = 0;
  for (LooseState& loose : loose_) loose = LooseState();
  for (auto& [trees, island] : pool_)
    if (&island->engine() != &whole_) island->engine().reset_counters();  // the reset has counted already
  forgotten_ = EngineCounters();
  Island& all = island_of(numbers_up_to(trees_.count()));
  all.dissolve(loose_, joint_friction_);
  leave_islands();
  VecX speed = VecX::Zero(scene_->tree.nv);
  add_size(scene_->tree, v, 1.0, speed);
  whole_.guards().bound_motion(state_.q, speed, options_.dt);
  std::vector<double> motion(scene_->geometries.size());
  for (std::size_t g = 0; g < motion.size(); ++g) motion[g] = whole_.guards().motion_of_geometry(static_cast<int>(g));
  graph_.restart(motion, {});
  q_ref_.resize(0);
  v_ref_.resize(0);
  if (scene_->tree.elements.servo_kp.size() > 0) {
    q_ref_.setZero(scene_->tree.nv);
    v_ref_.setZero(scene_->tree.nv);
  }
  divided_ = true;
  regroup(state_.time);
  q1_ = state_.q;
  p1_ = state_.p;
  for (Island* island : awake_) {
    island->engine().close_contacts_at_start();
    for (ChangeRecord change : island->engine().state().initial_changes) {
      change.guard = island->numbers().guards[change.guard];
      state_.initial_changes.push_back(change);
    }
  }
  std::stable_sort(state_.initial_changes.begin(), state_.initial_changes.end(),
                   [](const ChangeRecord& a, const ChangeRecord& b) { return a.guard < b.guard; });
}

// From islands to the whole engine, which goes on alone.
void World::unite() {
  if (!divided_) return;
  each_island([this](Island& island) {
    if (island.passed_over()) island.settle(state_.step);
    island.dissolve(loose_, joint_friction_);
  });
  leave_islands();
  Island& all = island_of(numbers_up_to(trees_.count()));
  all.form(state_.q, state_.p, loose_, joint_friction_, state_.time, state_.start_time);
  StepControl control = whole_.state().control;
  control.halved = state_.control.halved;
  ActuatorState actuators = whole_.state().actuators;
  actuators.saturated = state_.actuators.saturated;
  whole_.state() = state_;
  whole_.state().control = control;
  whole_.state().actuators = actuators;
  divided_ = false;
}

Island& World::island_of(const std::vector<int>& trees) {
  std::unique_ptr<Island>& found = pool_[trees];
  if (!found) {
    found = static_cast<int>(trees.size()) == trees_.count()
                ? std::make_unique<Island>(*scene_, trees_, trees, whole_)
                : std::make_unique<Island>(*scene_, trees_, trees, options_);
    found->engine().follow_motion();
    if (company_ != nullptr && &found->engine() != &whole_) found->engine().join(*company_);
  }
  found->last_used = state_.step;
  return *found;
}

// Keeps the pool small: the islands that were not in use for the longest time go.
void World::forget_unused() {
  const std::size_t most = kKept + 2 * static_cast<std::size_t>(trees_.count());
  if (pool_.size() <= 2 * most) return;
  std::vector<std::pair<long, const std::vector<int>*>> ages;
  for (const auto& [trees, island] : pool_) {
    const bool used = island_of_tree_[trees[0]] == island.get();
    if (!used && static_cast<int>(trees.size()) < trees_.count())
      ages.emplace_back(island->last_used, &island->trees());
  }
  std::stable_sort(ages.begin(), ages.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  for (std::size_t k = 0; k < ages.size() && pool_.size() > most; ++k) {
    const auto at = pool_.find(*ages[k].second);
    add(at->second->engine(), forgotten_);
    pool_.erase(at);
  }
}

void World::leave_islands() {
  std::fill(island_of_tree_.begin(), island_of_tree_.end(), nullptr);
  awake_.clear();
  count_ = 0;
  still_changed_ = true;
  sets_.reset(trees_.count());
}

// The islands of the interval that starts at t [s].
void World::regroup(double t) {
  // Where it is clear nobody awake is a neighbour of somebody of the same island.
  if (graph_.find_clear() && awake_trees_ == static_cast<int>(awake_.size())) return;
  for (Island* island : awake_)
    for (int tree : island->trees()) sets_.isolate(tree);
  for (Island* island : awake_) island->each_bond([this](int a, int b) { sets_.join(a, b); });
  if (count_ == 0)  // at the start
    for (const LooseState& loose : loose_)
      for (int guard : loose.touching) {
        const auto [a, b] = trees_.of_guard(*scene_, guard);
        sets_.join(a, b);
      }
  const double fall = scene_->tree.gravity.norm() * options_.dt * options_.dt;
  if (!graph_.clear()) {
    find_motion();
    for (Island* island : awake_) island->tell_expected(options_.dt, graph_);
    graph_.join_suspects(state_.q, 2.0 * fall, sets_);
  } else {
    graph_.forget_joins();
  }
  replace_islands(t, false);
}

// The sets of sets_ that are no islands, in the order of their first trees.
std::vector<std::vector<int>> World::changed_sets() {
  const auto sleeps = [this](int tree) {
    return island_of_tree_[tree] != nullptr && island_of_tree_[tree]->passed_over();
  };
  bool same = count_ > 0;
  for (std::size_t k = 0; k < awake_.size() && same; ++k)
    for (int tree : awake_[k]->trees()) same = same && sets_.root(tree) == awake_[k]->trees()[0];
  for (const auto& [a, b] : graph_.joins()) same = same && !sleeps(a) && !sleeps(b);
  if (same) return {};
  std::vector<std::pair<int, int>> members;  // root, tree
  const auto add = [&](const std::vector<int>& trees) {
    for (int tree : trees) members.emplace_back(sets_.root(tree), tree);
  };
  if (count_ == 0)
    add(numbers_up_to(trees_.count()));
  else
    for (Island* island : awake_) add(island->trees());
  std::vector<Island*> met;  // that lay still
  for (const auto& [a, b] : graph_.joins())
    for (int tree : {a, b}) {
      Island* island = island_of_tree_[tree];
      if (!sleeps(tree) || std::find(met.begin(), met.end(), island) != met.end()) continue;
      met.push_back(island);
      add(island->trees());
    }
  std::sort(members.begin(), members.end());
  std::vector<std::vector<int>> changed;
  std::vector<int> set;
  for (std::size_t k = 0; k < members.size(); ++k) {
    set.push_back(members[k].second);
    if (k + 1 < members.size() && members[k + 1].first == members[k].first) continue;
    const Island* before = island_of_tree_[set[0]];
    if (before == nullptr || before->trees() != set) changed.push_back(std::move(set));
    set.clear();
  }
  return changed;
}

// Makes the islands those of sets_. Islands that stay are kept as they are; the others are dissolved, or undone, and
// new ones formed, which are in to_run_.
void World::replace_islands(double t, bool undo) {
  to_run_.clear();
  const std::vector<std::vector<int>> changed = changed_sets();
  if (changed.empty()) return;
  if (!undo) find_motion();
  for (const std::vector<int>& trees : changed)
    for (int tree : trees) {
      Island* island = island_of_tree_[tree];
      if (island == nullptr || island->trees()[0] != tree) continue;
      --count_;
      if (island->passed_over()) {
        still_changed_ = true;
        island->settle(state_.step);
        island->dissolve(loose_, joint_friction_);
      } else if (undo) {
        island->undo(loose_, joint_friction_);
        island->engine().forget_counts();
      } else {
        island->dissolve(loose_, joint_friction_);
      }
    }
  for (const std::vector<int>& trees : changed)
    for (int tree : trees) island_of_tree_[tree] = nullptr;
  for (const std::vector<int>& trees : changed) {
    Island& island = island_of(trees);
    island.form(state_.q, state_.p, loose_, joint_friction_, t, state_.start_time);
    island.join_graph(graph_);
    for (int tree : trees) island_of_tree_[tree] = &island;
    to_run_.push_back(&island);
    ++count_;
  }
  std::vector<Island*> awake;
  for (Island* island : awake_)
    if (island_of_tree_[island->trees()[0]] == island) awake.push_back(island);
  awake.insert(awake.end(), to_run_.begin(), to_run_.end());
  set_awake(std::move(awake));
  forget_unused();
}

// These are advanced from now on.
void World::set_awake(std::vector<Island*> awake) {
  awake_ = std::move(awake);
  std::sort(awake_.begin(), awake_.end(),
            [](const Island* a, const Island* b) { return a->trees()[0] < b->trees()[0]; });
  awake_trees_ = 0;
  std::vector<int> geometries;
  for (Island* island : awake_) {
    awake_trees_ += static_cast<int>(island->trees().size());
    const std::vector<int>& own = island->numbers().geometries;
    geometries.insert(geometries.end(), own.begin(), own.end());
  }
  graph_.set_active(std::move(geometries));
}

// Tells still_ which islands are passed over, where that has changed.
void World::find_still() {
  if (!still_changed_) return;
  std::vector<Island*> still;
  std::size_t k = 0;
  each_island([&](Island& island) {
    if (k < awake_.size() && awake_[k] == &island)
      ++k;
    else
      still.push_back(&island);
  });
  still_.set(std::move(still));
  still_changed_ = false;
}

// Of the islands that have made the step to state_, those that have come to rest are passed over from now on.
void World::let_sleep() {
  if (std::none_of(awake_.begin(), awake_.end(), [](const Island* island) { return island->passed_over(); })) return;
  std::vector<Island*> awake;
  for (Island* island : awake_) {
    if (!island->passed_over()) {
      awake.push_back(island);
      continue;
    }
    island->gather(q1_, p1_);
    island->tell_motion(graph_);
    still_changed_ = true;
  }
  set_awake(std::move(awake));
}

void World::run(Island& island, double length) {
  island.step(state_.q, state_.step, state_.start_time + static_cast<double>(state_.step) * options_.dt, length, tau_,
              q_ref_, v_ref_, island_progress_);
  island.last_used = state_.step;
}

// Those of to_run_. What happens in one does not depend on the others, nor on who advances it.
void World::run_all(double length) {
  if (helpers_ && company_ == nullptr && to_run_.size() > 1)
    helpers_->run(static_cast<int>(to_run_.size()), [&](int i) { run(*to_run_[static_cast<std::size_t>(i)], length); });
  else
    for (Island* island : to_run_) run(*island, length);
}

// Tells the graph what it was not told while intervals were clear: how far everything has moved in the interval, and
// before.
void World::tell_motion() {
  for (Island* island : awake_) island->tell_motion(graph_);
  graph_.measure();
}

// As this, of the last interval.
void World::find_motion() {
  if (graph_.knows_motion()) return;
  for (Island* island : awake_) island->tell_motion(graph_);
  graph_.know_motion();
}

// Joins the islands that may have met in the interval from t [s].
void World::join_met(double t) {
  if (graph_.stays_clear()) {
    to_run_.clear();
    return;
  }
  if (graph_.clear()) {
    for (Island* island : awake_)
      for (int tree : island->trees()) sets_.isolate(tree);
    for (Island* island : awake_)
      for (int tree : island->trees()) sets_.join(island->trees()[0], tree);
    tell_motion();
  }
  graph_.join_met(state_.q, sets_);
  replace_islands(t, true);
}

// All islands over the interval, those that have met together.
void World::run_interval(double length) {
  const double t = state_.start_time + static_cast<double>(state_.step) * options_.dt;
  regroup(t);
  to_run_ = awake_;
  while (!to_run_.empty()) {
    run_all(length);
    for (Island* island : to_run_) island->measure(graph_);
    join_met(t);
  }
}

// Where an island has ended early, the run ends at that time: the others are brought there. False: none has.
bool World::end_early(double length) {
  const double t = state_.start_time + static_cast<double>(state_.step) * options_.dt;
  Island* first = nullptr;
  for (Island* island : awake_)
    if (island->ended_early() &&
        (first == nullptr || island->engine().state().status.time < first->engine().state().status.time))
      first = island;
  if (first == nullptr) return false;
  tell_motion();
  state_.status = first->engine().state().status;
  if (state_.status.guard >= 0) state_.status.guard = first->numbers().guards[state_.status.guard];
  const double taken = std::clamp(state_.status.time - t, 0.0, length);
  for (Island* island : awake_) {
    if (island == first) continue;
    island->undo(loose_, joint_friction_);
    island->engine().forget_counts();
    island->form(state_.q, state_.p, loose_, joint_friction_, t, state_.start_time);
    island->join_graph(graph_);
    island->recording().clear();
    if (taken > 0.0) run(*island, taken);
  }
  tell_motion();
  return true;
}

void World::set_inputs(const MatX& tau, const MatX& target, long k) {
  const int nv = scene_->tree.nv;
  static const Eigen::RowVectorXd none;
  set_input(tau.rows() > 0 ? InputRow(tau.row(k)) : InputRow(none), tau_);
  if (q_ref_.size() == 0 || target.rows() == 0) return;
  set_input(target.row(k).head(nv), q_ref_);
  set_input(target.row(k).tail(nv), v_ref_);
}

// What lies still goes on where one of its inputs has changed, or where there were none before.
void World::set_input(const InputRow& now, VecX& input) {
  std::vector<Island*> woken;
  const auto wake = [&](Island& island) {
    if (!island.passed_over()) return;
    island.wake(state_.step);
    woken.push_back(&island);
  };
  if (awake_trees_ == trees_.count()) {
    // nothing lies still
  } else if (now.size() != input.size()) {
    each_island(wake);
  } else {
    for (Eigen::Index d = 0; d < now.size(); ++d)
      if (now[d] != input[d]) wake(*island_of_tree_[trees_.of_joint(scene_->tree.dof_joint[d])]);
  }
  input = now.transpose();
  if (woken.empty()) return;
  find_motion();
  still_changed_ = true;
  woken.insert(woken.end(), awake_.begin(), awake_.end());
  set_awake(std::move(woken));
  graph_.end_clear();
}

// The ends of all islands become the state.
void World::accept(double t, double length, Recording& recording) {
  for (Island* island : awake_) {
    island->gather(q1_, p1_);
    if (island->asleep()) island->fall_asleep(state_.step, length);
    RunState& part = island->engine().state();
    state_.work.take(part.work, island->numbers().reactions);
    add_counts(part, state_);
    state_.dense_steps += static_cast<long>(island->recording().dense.size());
    island->engine().forget_counts();
  }
  find_still();
  still_.add_reactions(length, state_.work);
  state_.dense_steps += still_.dense_steps();
  merge_recordings(t, length, recording);
  state_.q.swap(q1_);
  state_.p.swap(p1_);
  graph_.commit();
  let_sleep();
}

void World::record_node(Recording& recording) {
  recording.t.push_back(state_.time);
  recording.q.insert(recording.q.end(), state_.q.data(), state_.q.data() + state_.q.size());
  recording.p.insert(recording.p.end(), state_.p.data(), state_.p.data() + state_.p.size());
  state_.work.record_node(state_.time, scene_->tree, recording);
}

// Asks the caller whether to go on.
bool World::ask(double time, long impacts) {
  if (reports_.ask(time, impacts)) return true;
  stopped_ = true;
  return false;
}

bool World::report_progress() {
  if (ask(state_.time, state_.impacts)) return true;
  state_.status = {StatusCode::kInterrupted, "interrupted", state_.time, -1, kNaN, kNaN};
  return false;
}

Status World::advance(long steps, const MatX& tau, const MatX& target, long record_every, const Progress& progress,
                      Recording& recording) {
  if (!divided_) return whole_.advance(steps, tau, target, record_every, progress, recording);
  reports_.begin(progress);
  stopped_ = false;
  state_.status = {StatusCode::kSuccess, "", state_.time, -1, kNaN, kNaN};
  if (tau.rows() > 0) state_.work.expect_inputs();
  if (steps > 1) recording.expect(steps / record_every + 2, scene_->tree.nq, scene_->tree.nv);
  if (recording.t.empty()) record_node(recording);
  std::vector<ChangeRecord>& initial = state_.initial_changes;
  recording.changes.insert(recording.changes.end(), initial.begin(), initial.end());
  initial.clear();
  const bool free = tau.rows() == 0 && target.rows() == 0;
  for (long k = 0; k < steps; ++k) {
    const long passed = free ? pass_undisturbed_intervals(steps - k, record_every, recording) : 0;
    if (passed > 0 && !report_progress()) return state_.status;
    k += passed;
    if (k == steps) break;
    const double t = state_.start_time + static_cast<double>(state_.step) * options_.dt;
    set_inputs(tau, target, k);
    run_interval(options_.dt);
    if (end_early(options_.dt)) {
      accept(t, state_.status.time - t, recording);
      state_.time = state_.start_time + static_cast<double>(state_.step) * options_.dt;
      state_.time = std::max(state_.time, state_.status.time);
      if (state_.status.code != StatusCode::kNotFinite && state_.time > recording.t.back()) record_node(recording);
      return state_.status;
    }
    accept(t, options_.dt, recording);
    ++state_.step;
    state_.time = state_.start_time + static_cast<double>(state_.step) * options_.dt;
    if (state_.step % record_every == 0 || k + 1 == steps) record_node(recording);
    if (!report_progress()) return state_.status;
  }
  state_.status.time = state_.time;
  return state_.status;
}

Status World::run_auto(double duration, const AutoSteps& steps, const Progress& progress, Recording& recording) {
  unite();
  return whole_.run_auto(duration, steps, progress, recording);
}

EngineCounters World::counters() const {
  EngineCounters sum = forgotten_;
  add(whole_, sum);
  if (divided_)
    for (const auto& [trees, island] : pool_)
      if (&island->engine() != &whole_) add(island->engine(), sum);
  return sum;
}

std::shared_ptr<const SavedWorld> World::save() {
  auto saved = std::make_shared<SavedWorld>();
  saved->divided = divided_;
  if (!divided_) {
    saved->whole = whole_.save();
    return saved;
  }
  saved->run = state_;
  saved->loose = loose_;
  saved->joint_friction = joint_friction_;
  find_motion();
  saved->motion = graph_.motion();
  saved->straight = graph_.paths().straight();
  saved->tau = tau_;
  saved->q_ref = q_ref_;
  saved->v_ref = v_ref_;
  saved->counters = counters();
  each_island([&](Island& island) {
    const bool asleep = island.passed_over();
    if (asleep) island.settle(state_.step);
    saved->islands.push_back({island.trees(), island.engine().save(), island.rest(),
                              asleep ? island.recording() : Recording(), asleep ? island.mean_reactions() : VecX(),
                              island.tau(), island.target(), island.turns()});
  });
  return saved;
}

void World::restore(const SavedWorld& saved) {
  divided_ = saved.divided;
  if (!divided_) {
    whole_.restore(*saved.whole);
    return;
  }
  state_ = saved.run;
  loose_ = saved.loose;
  joint_friction_ = saved.joint_friction;
  tau_ = saved.tau;
  q_ref_ = saved.q_ref;
  v_ref_ = saved.v_ref;
  graph_.restart(saved.motion, saved.straight);
  q1_ = state_.q;
  p1_ = state_.p;
  leave_islands();
  std::vector<Island*> awake;
  for (const SavedWorld::SavedIsland& from : saved.islands) {
    Island& island = island_of(from.trees);
    island.engine().restore(*from.engine);
    island.restore_rest(from.rest, from.record, from.mean_reactions, from.tau, from.target, from.turns, state_.step);
    island.join_graph(graph_);
    for (int tree : from.trees) {
      island_of_tree_[tree] = &island;
      sets_.join(from.trees[0], tree);
    }
    ++count_;
    if (!island.passed_over()) awake.push_back(&island);
  }
  set_awake(std::move(awake));
  for (auto& [trees, island] : pool_) island->engine().reset_counters();
  whole_.reset_counters();
  forgotten_ = saved.counters;
}

}  // namespace contactvi

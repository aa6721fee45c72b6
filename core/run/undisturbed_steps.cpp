// Control steps of a run in company that were solved in advance and in which nothing happens, made at once. Each leaves
// what it would leave if it were made by itself.
#include <algorithm>

#include "run/state_range.hpp"
#include "run/world.hpp"

namespace contactvi {

// Whether a control step without inputs is one smooth step after which nothing has to be decided, if no guard is near.
bool Simulator::flies_undisturbed() const {
  const Elements& e = scene_->tree.elements;
  return truncation_.bound == 0.0 && !options_.dense && !law_->implicit() && guide_ == nullptr &&
         !state_.dense.active && contact_step_.empty() && !has_phase() && state_.control.flight == 0.0 &&
         state_.control.free.longest >= options_.dt && e.effort.size() + e.speed.size() == 0 && branches_.none() &&
         state_.actuators.given.size() == 0;
}

int Simulator::foresee(long most) {
  if (!in_company_ || !flies_undisturbed()) return 0;
  int count = integrator_.look_ahead(state_.q, state_.p, options_.dt);
  const StepsAhead& steps = foreseen();
  count = static_cast<int>(std::min<long>(count, most));
  for (int k = 0; k < count; ++k)
    if (!in_range(steps.next(k, StepsAhead::kQ), state_.q.size()) ||
        !in_range(steps.next(k, StepsAhead::kP), state_.p.size()) ||
        long_steps_.may_be_long(steps.next(k, StepsAhead::kV), 1, options_.dt))
      count = k;
  if (guards_.count() == 0 && !follows_motion_) return count;
  finder_.set_stepper(integrator_);
  return finder_.foresee(state_.q, state_.p, options_.dt, steps, count);
}

WorkAccount::FreeWork Simulator::foreseen_work(int step) {
  if (!state_.work.tally().does_work) return {};
  integrator_.show_ahead(step);
  return state_.work.of(integrator_);
}

void Simulator::pass_foreseen(int count, double last_start) {
  const StepsAhead& steps = foreseen();
  sequence_.begin_step();
  sequence_.forget();
  changes_.begin_interval();
  state_.dense.located.add(0.0, count * allowed_cost(options_.dt));
  state_.dense.since_return += count;
  state_.control.flew(options_.dt);
  if (guards_.count() > 0 || follows_motion_) finder_.pass_foreseen(steps, count);
  std::copy_n(steps.next(count - 1, StepsAhead::kQ), state_.q.size(), state_.q.data());
  std::copy_n(steps.next(count - 1, StepsAhead::kP), state_.p.size(), state_.p.data());
  integrator_.set_time(last_start);
  integrator_.accept_ahead(count - 1);
}

void Simulator::pass_island(int count, long last_step, double last_start, const Progress& progress) {
  reports_.go_on(progress);
  state_.step = last_step;
  state_.status.code = StatusCode::kSuccess;
  pass_foreseen(count, last_start);
}

// The undisturbed ones among the next control steps, of which so many are left; returns how many were made.
long Simulator::pass_undisturbed_steps(long left, long record_every, Recording& recording) {
  const int count = foresee(left);
  if (count == 0) return 0;
  const auto time = [this](long step) { return state_.start_time + static_cast<double>(step) * options_.dt; };
  if (!recording.phase_t.empty()) record_phase(time(state_.step), options_.dt, StepKind::kFree, recording);
  const bool works = state_.work.tally().does_work;
  long until_node = record_every - state_.step % record_every;
  for (int k = 0; k < count; ++k) {
    if (works) state_.work.add(foreseen_work(k));
    ++state_.step;
    const bool node = --until_node == 0;
    if (node) until_node = record_every;
    if (node || k + 1 == left)
      record_node(time(state_.step), foreseen().next(k, StepsAhead::kQ), foreseen().next(k, StepsAhead::kP), recording);
  }
  state_.time = time(state_.step);
  pass_foreseen(count, time(state_.step - 1));
  return count;
}

// Its next steps, none of which can put it to sleep.
int Island::foresee(long most, const IslandGraph& graph) {
  if (rest_.steps + 1 >= Rest::kSteps || depends_on_time_ || tau_.size() > 0) return 0;
  const int count = engine_->foresee(std::min<long>(most, Rest::kSteps - 1 - rest_.steps));
  if (count > 0) find_share(graph);
  return count;
}

void Island::gather_foreseen(int step, VecX& q, VecX& p) const {
  const double *own_q = engine_->foreseen().next(step, StepsAhead::kQ),
               *own_p = engine_->foreseen().next(step, StepsAhead::kP);
  for (std::size_t i = 0; i < numbers_->q.size(); ++i) q[numbers_->q[i]] = own_q[i];
  for (std::size_t i = 0; i < numbers_->v.size(); ++i) p[numbers_->v[i]] = own_p[i];
}

void Island::pass_foreseen(int count, long last_step, double last_start, const Progress& progress) {
  const double* before = std::as_const(*engine_).state().q.data();
  for (int k = 0; k < count; ++k) {
    const double* now = engine_->foreseen().next(k, StepsAhead::kQ);
    rest_.count_undisturbed(before, now, levers_);
    before = now;
  }
  recording_.clear();
  ok_ = true;
  forget_straight();
  engine_->pass_island(count, last_step, last_start, progress);
}

// The undisturbed ones among the next intervals, of which so many are left, where every tree is an island; returns how
// many were made.
long World::pass_undisturbed_intervals(long left, long record_every, Recording& recording) {
  if (!all_alone()) return 0;
  long most = left;
  for (Island* island : awake_) {
    most = island->foresee(most, graph_);
    if (most == 0) return 0;
  }
  foreseen_.assign(most, 0.0);
  for (int k = 0; k < most; ++k)
    for (Island* island : awake_) {
      const double intervals = island->reference_intervals(k);
      if (!(intervals <= foreseen_[k])) foreseen_[k] = intervals;  // NaN stays
    }
  const int count = graph_.foresee(foreseen_);
  if (count == 0) return 0;
  graph_.pass(foreseen_, count);
  const auto time = [this](long step) { return state_.start_time + static_cast<double>(step) * options_.dt; };
  const double first = time(state_.step);
  long until_node = record_every - state_.step % record_every;
  for (int k = 0; k < count; ++k) {
    for (Island* island : awake_) state_.work.add(island->engine().foreseen_work(k), island->numbers().reactions);
    ++state_.step;
    state_.time = time(state_.step);
    const bool node = --until_node == 0;
    if (node) until_node = record_every;
    const bool recorded = node || k + 1 == left;
    if (!recorded && k + 1 < count) continue;
    for (Island* island : awake_) island->gather_foreseen(k, state_.q, state_.p);
    if (recorded) record_node(recording);
  }
  for (Island* island : awake_) {
    island->pass_foreseen(count, state_.step - 1, time(state_.step - 1), island_progress_);
    island->last_used = state_.step - 1;
  }
  merge_phases(first, recording);
  return count;
}

}  // namespace contactvi

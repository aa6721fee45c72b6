// Simulator: control steps of a run in company that were solved in advance and in which nothing happens, made at once.
// Each leaves what it would leave if it were made by itself.
#include <algorithm>

#include "run/simulator.hpp"
#include "run/state_range.hpp"

namespace contactvi {

// Whether a control step without inputs is one smooth step after which nothing has to be decided, if no guard is near.
bool Simulator::flies_quietly() const {
  const Elements& e = scene_->tree.elements;
  return truncation_.bound == 0.0 && !options_.dense && !law_->implicit() && guide_ == nullptr &&
         !state_.dense.active && contact_step_.empty() && state_.control.flight == 0.0 &&
         state_.control.free.longest >= options_.dt && e.effort.size() + e.speed.size() == 0 &&
         state_.actuators.given.size() == 0;
}

int Simulator::foresee(long most) {
  int count = integrator_.steps_ahead(state_.q, state_.p, options_.dt);
  if (count == 0 || !flies_quietly()) return 0;
  const StepsAhead& steps = foreseen();
  count = static_cast<int>(std::min<long>(count, most));
  for (int k = 0; k < count; ++k)
    if (!in_range(steps.next(k, StepsAhead::kQ), state_.q.size()) ||
        !in_range(steps.next(k, StepsAhead::kP), state_.p.size()))
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
  changes_.begin_interval();
  for (int k = 0; k < count; ++k) state_.dense.events.fade(options_.dt);
  state_.dense.since_return += count;
  contact_step_.allow_rescues(most_rescues(options_.dt));
  state_.control.flew(options_.dt);
  if (guards_.count() > 0 || follows_motion_) finder_.pass_foreseen(steps, count);
  std::copy_n(steps.next(count - 1, StepsAhead::kQ), state_.q.size(), state_.q.data());
  std::copy_n(steps.next(count - 1, StepsAhead::kP), state_.p.size(), state_.p.data());
  integrator_.set_time(last_start);
  integrator_.accept_ahead(count - 1);
}

// The quiet ones among the next control steps, of which so many are left; returns how many were made.
long Simulator::pass_quiet_steps(long left, long record_every, Recording& recording) {
  const int count = foresee(left);
  if (count == 0) return 0;
  const auto time = [this](long step) { return state_.start_time + static_cast<double>(step) * options_.dt; };
  if (!recording.phase_t.empty()) record_phase(time(state_.step), options_.dt, StepKind::kFree, recording);
  for (int k = 0; k < count; ++k) {
    state_.work.add(foreseen_work(k));
    ++state_.step;
    if (state_.step % record_every == 0 || k + 1 == left)
      record_node(time(state_.step), foreseen().next(k, StepsAhead::kQ), foreseen().next(k, StepsAhead::kP), recording);
  }
  state_.time = time(state_.step);
  pass_foreseen(count, time(state_.step - 1));
  return count;
}

}  // namespace contactvi

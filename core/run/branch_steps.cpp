// Simulator: the branches of piecewise force laws in smooth steps (branches.hpp).
#include "run/simulator.hpp"

namespace contactvi {

// Of a part of a step, a smooth one or not: whether derivatives do not know the limits that actuators were at.
void Simulator::count_saturated(bool smooth) {
  if (actuation_.limited_dofs().empty()) return;
  const bool any = smooth ? actuation_.is_any(Drive::kCut) : actuation_.is_any_limited();
  state_.actuators.saturated += any ? 1 : 0;
}

// The branches of the smooth step that comes next, and v_ at its start.
bool Simulator::begin_branches(const Interval& interval) {
  // Steps of run_auto have no inputs, and without servos no limits are applied in advance.
  const bool applied = truncation_.bound == 0.0 || scene_->tree.elements.servo_kp.size() > 0;
  const bool known = !actuation_.limited_dofs().empty() && applied && !interval.keeps_branches;
  if (known) {
    v_ = actuation_.start_velocity();
  } else if (!integrator_.node_velocity(state_.q, state_.p, v_)) {
    return end(StatusCode::kNewtonFailed, interval.start + interval.done, "the mass matrix is not positive definite");
  }
  branches_.begin_step(state_.q, v_, interval.keeps_branches);
  return true;
}

// Goes to the branch that follows at the state, where the last smooth step has ended. moved: it has come there by one.
bool Simulator::enter_branch(Interval& interval, const VecX& q, const VecX& v, bool moved, Recording& recording) {
  integrator_.forget();
  if (switches_.which() >= branches_.count()) {
    change_contact(switches_.which() - branches_.count(), interval.start + interval.done, v, moved, recording);
    if (!moved && (!state_.control.count_standstill() || state_.control.stands_still()))
      return leave_to_contact_steps(interval.start + interval.done);
    return true;
  }
  if (!branches_.change(switches_.which(), interval.start + interval.done, q, v, moved)) ++state_.switches.held;
  state_.switches.located += branches_.switched() ? 1 : 0;
  state_.switches.jumps += branches_.jumped() ? 1 : 0;
  interval.keeps_branches = true;
  return true;
}

bool Simulator::end_failed_switch(Search outcome, double time) {
  if (outcome == Search::kNewtonFailed)
    return end(StatusCode::kNewtonFailed, time,
               std::string("a partial step to where a force changes its law was not solved: ") + integrator_.why());
  return end(StatusCode::kEventUnresolved, time, "a force changes its law in a step, and where was not found");
}

}  // namespace contactvi

// Simulator: what bodies bring along when they become an island, and what they take with them when it ends.
#include "run/simulator.hpp"

namespace contactvi {

namespace {
bool is_empty(const DenseStep::Memory& memory) {
  return memory.impulses.empty() && memory.closed.empty() && memory.change.size() == 0 &&
         memory.joint_friction.size() == 0;
}
}  // namespace

bool Simulator::carries_lists() const {
  return !(contact_step_.contacts().empty() && !finder_.any_touching() && finder_.exempted().empty() &&
           state_.separated.empty() && state_.flights.entries().empty() && contact_step_.friction_joints().empty() &&
           is_empty(dense_step_.memory()));
}

void Simulator::hand_over(Handover& to) const {
  to.control = state_.control;
  to.largest_speed = state_.largest_speed;
  to.contact_steps = state_.contact_steps;
  to.dense = state_.dense;
  to.dense_step.h = dense_step_.memory().h;
  const bool any = carries_lists();
  if (!any && !to.any) return;  // those of most islands are empty
  to.any = any;
  to.contacts = contact_step_.contacts();
  finder_.list_touching(to.touching);
  to.exempt = finder_.exempted();
  to.dense_step = dense_step_.memory();
  to.separated = state_.separated;
  to.flights = state_.flights.entries();
  to.joint_friction.clear();
  for (const FrictionJoint& joint : contact_step_.friction_joints())
    to.joint_friction.push_back({joint.anchored, joint.anchor, 0.0});
  const VecX& forces = to.dense_step.joint_friction;
  for (Eigen::Index k = 0; k < forces.size(); ++k) to.joint_friction[k].force = forces[k];
}

void Simulator::take_over(const Handover& from, const EngineMemory& fresh, double t, double start_time) {
  RunState& s = state_;
  s.status = Status();
  s.start_time = start_time;
  s.time = t;
  s.q = from.q;
  s.p = from.p;
  s.adaptive_dt = options_.dt;
  s.control = from.control;
  s.control.halved = 0;
  s.largest_speed = from.largest_speed;
  s.contact_steps = from.contact_steps;
  s.separated = from.separated;
  s.flights.clear();
  for (const Flights::Entry& entry : from.flights) s.flights.at(entry.first) = entry.second;
  s.initial_changes.clear();
  s.actuators.saturated = 0;
  s.switches = SwitchCounts();
  s.watch = EnergyWatch();
  s.actuators.servo.any = false;
  s.work.start(t, scene_->tree, s.p, does_work_);
  s.dense = from.dense;
  s.impacts = s.rejected = s.dense_steps = 0;
  s.contact_seconds = 0.0;
  actuation_.start();
  recall(fresh);
  contact_step_.set_nominal(options_.dt);
  contact_step_.contacts() = from.contacts;
  contacts_.update_persistent_guards();
  DenseStep::Memory dense = from.dense_step;
  dense.joint_friction.resize(static_cast<Eigen::Index>(from.joint_friction.size()));
  for (std::size_t k = 0; k < from.joint_friction.size(); ++k) {
    const JointFriction& joint = from.joint_friction[k];
    contact_step_.friction_joints()[k].anchored = joint.anchored;
    contact_step_.friction_joints()[k].anchor = joint.anchor;
    dense.joint_friction[static_cast<Eigen::Index>(k)] = joint.force;
  }
  dense_step_.recall(dense);
  for (int g : from.touching) finder_.set_touching(g, true);
  for (int g : from.exempt) finder_.exempt(g);
  law_->start_run(free_state(t), s.reference);
}

void Simulator::forget_counts() {
  state_.impacts = state_.dense_steps = state_.control.halved = state_.actuators.saturated = 0;
  state_.switches = SwitchCounts();
  state_.contact_seconds = 0.0;
  state_.work.clear();
}

void Simulator::reset_counters() {
  integrator_.counters = StepCounters();
  guards_.counters = GuardCounters();
  contact_step_.counters = ContactStepCounters();
  dense_step_.counters = DenseStepCounters();
}

bool Simulator::step_island(long step, double t, double length, const VecX& tau, const MatX& target,
                            const Progress& progress, Recording& recording) {
  reports_.go_on(progress);
  state_.step = step;
  state_.status.code = StatusCode::kSuccess;
  if (tau.size() > 0) state_.work.expect_inputs();
  does_work_ |= tau.size() > 0;
  actuation_.set(t, tau, target, 0, state_.q, state_.p);
  return advance_interval(t, length, actuation_.force(), recording);
}

}  // namespace contactvi

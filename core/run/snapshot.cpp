// Simulator: saves all that the rest of a run depends on, and restores it.
#include "run/simulator.hpp"

namespace contactvi {

EngineMemory Simulator::memory() {
  return {integrator_.memory(), contact_step_.memory(), finder_.memory(), guards_.memory(),
          finder_.stepper() == &contact_step_};
}

Snapshot Simulator::snapshot() {
  return {state_, memory(), {integrator_.counters, guards_.counters, contact_step_.counters}};
}

std::shared_ptr<const Snapshot> Simulator::save() { return std::make_shared<const Snapshot>(snapshot()); }

void Simulator::recall(const EngineMemory& memory) {
  contact_step_.contacts() = memory.contact_step.contacts;
  contacts_.update_persistent_guards();
  contact_step_.recall(memory.contact_step);
  integrator_.recall(memory.integrator);
  finder_.set_stepper(memory.searched_contact_step ? static_cast<Stepper&>(contact_step_)
                                                   : static_cast<Stepper&>(integrator_));
  finder_.recall(memory.finder);
  guards_.recall(memory.guards);
}

// The state and the memory of the parts; the counters of the parts go on.
void Simulator::restore_state(const Snapshot& s) {
  state_ = s.run;
  actuation_.apply_servo();
  recall(s.memory);
}

void Simulator::hand_over(Handover& to) const {
  to.q = state_.q;
  to.p = state_.p;
  to.control = state_.control;
  to.largest_speed = state_.largest_speed;
  to.kinetic = state_.kinetic;
  to.contacts = contact_step_.contacts();
  to.touching.clear();
  for (int g = 0; g < guards_.count(); ++g)
    if (finder_.touching(g)) to.touching.push_back(g);
  to.exempt = finder_.exempted();
  to.separated = state_.separated;
  to.flights = state_.flights.entries();
  to.anchors.clear();
  for (const ContactStep::FrictionJoint& joint : contact_step_.friction_joints())
    to.anchors.emplace_back(joint.anchored, joint.anchor);
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
  s.kinetic = from.kinetic;
  s.separated = from.separated;
  s.flights.clear();
  for (const Flights::Entry& entry : from.flights) s.flights.at(entry.first) = entry.second;
  s.initial_changes.clear();
  s.actuators.saturated = 0;
  s.actuators.servo.any = false;
  s.work.start(t, scene_->tree.elements.constraint_rows, does_work_);
  s.impacts = s.rejected = 0;
  s.contact_seconds = 0.0;
  actuation_.start();
  recall(fresh);
  contact_step_.set_nominal(options_.dt);
  contact_step_.contacts() = from.contacts;
  contacts_.update_persistent_guards();
  for (std::size_t k = 0; k < from.anchors.size(); ++k) {
    contact_step_.friction_joints()[k].anchored = from.anchors[k].first;
    contact_step_.friction_joints()[k].anchor = from.anchors[k].second;
  }
  for (int g : from.touching) finder_.set_touching(g, true);
  for (int g : from.exempt) finder_.exempt(g);
  law_->start_run(free_state(), s.reference);
}

void Simulator::forget_counts() {
  state_.impacts = state_.control.halved = state_.actuators.saturated = 0;
  state_.contact_seconds = 0.0;
  state_.work.clear();
}

void Simulator::reset_counters() {
  integrator_.counters = StepCounters();
  guards_.counters = GuardCounters();
  contact_step_.counters = ContactStepCounters();
}

bool Simulator::step_island(long step, double t, double length, const VecX& tau, const MatX& target,
                            const Progress& progress, Recording& recording) {
  progress_ = &progress;
  state_.step = step;
  state_.status.code = StatusCode::kSuccess;
  if (tau.size() > 0) state_.work.expect_inputs();
  does_work_ |= tau.size() > 0;
  actuation_.set(tau, target, 0, state_.q, state_.p);
  return advance_interval(t, length, actuation_.force(), recording);
}

void Simulator::restore(const Snapshot& s) {
  restore_state(s);
  integrator_.counters = s.counters.steps;
  guards_.counters = s.counters.guards;
  contact_step_.counters = s.counters.contact;
}

}  // namespace contactvi

// Simulator: saves all that the rest of a run depends on, and restores it.
#include "run/simulator.hpp"

namespace contactvi {

EngineMemory Simulator::memory() {
  return {integrator_.memory(), contact_step_.memory(), dense_step_.memory(),
          finder_.memory(),     guards_.memory(),       finder_.stepper() == &contact_step_};
}

Snapshot Simulator::snapshot() {
  return {state_, memory(), {integrator_.counters, guards_.counters, contact_step_.counters, dense_step_.counters}};
}

std::shared_ptr<const Snapshot> Simulator::save() { return std::make_shared<const Snapshot>(snapshot()); }

void Simulator::recall(const EngineMemory& memory) {
  contact_step_.contacts() = memory.contact_step.contacts;
  contacts_.update_persistent_guards();
  contact_step_.recall(memory.contact_step);
  dense_step_.recall(memory.dense_step);
  integrator_.recall(memory.integrator);
  finder_.set_stepper(memory.searched_contact_step ? static_cast<Stepper&>(contact_step_)
                                                   : static_cast<Stepper&>(integrator_));
  finder_.recall(memory.finder);
  guards_.forget_distances();  // those of another run are found with other bounds
  guards_.recall(memory.guards);
}

// The state and the memory of the parts; the counters of the parts go on.
void Simulator::restore_state(const Snapshot& s) {
  state_ = s.run;
  actuation_.apply_servo();
  recall(s.memory);
}

void Simulator::restore(const Snapshot& s) {
  restore_state(s);
  integrator_.counters = s.counters.steps;
  guards_.counters = s.counters.guards;
  contact_step_.counters = s.counters.contact;
  dense_step_.counters = s.counters.dense;
}

void Simulator::renew() {
  state_ = RunState();
  recall(fresh_);
  reset_counters();
  forget_inputs();
  truncation_ = Truncation();
  take_contact_steps();
  take_dense_steps();
  take_held_steps();
  take_impact_blocks();
}

void Simulator::forget_inputs() { does_work_ = scene_does_work(); }

}  // namespace contactvi

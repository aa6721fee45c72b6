// Simulator: saves all that the rest of a run depends on, and restores it.
#include "run/simulator.hpp"

namespace contactvi {

Snapshot Simulator::snapshot() {
  return {state_,
          {integrator_.memory(), contact_step_.memory(), dense_step_.memory(), finder_.memory(), guards_.memory(),
           finder_.stepper() == &contact_step_},
          {integrator_.counters, guards_.counters, contact_step_.counters}};
}

std::shared_ptr<const Snapshot> Simulator::save() { return std::make_shared<const Snapshot>(snapshot()); }

// The state and the memory of the parts; the counters of the parts go on.
void Simulator::restore_state(const Snapshot& s) {
  state_ = s.run;
  actuation_.apply_servo();
  contact_step_.contacts() = s.memory.contact_step.contacts;
  contacts_.update_persistent_guards();
  contact_step_.recall(s.memory.contact_step);
  dense_step_.recall(s.memory.dense_step);
  integrator_.recall(s.memory.integrator);
  finder_.set_stepper(s.memory.searched_contact_step ? static_cast<Stepper&>(contact_step_)
                                                     : static_cast<Stepper&>(integrator_));
  finder_.recall(s.memory.finder);
  guards_.recall(s.memory.guards);
}

void Simulator::restore(const Snapshot& s) {
  restore_state(s);
  integrator_.counters = s.counters.steps;
  guards_.counters = s.counters.guards;
  contact_step_.counters = s.counters.contact;
}

}  // namespace contactvi

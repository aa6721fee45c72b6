// Simulator: saves all that the rest of a run depends on, and restores it.
#include "run/simulator.hpp"

namespace contactvi {

struct Simulator::Snapshot {
  AdaptiveStart start;
  Integrator::Memory integrator;
  ContactStep::Memory contact_step;
  EventFinder::Memory finder;
  Guards::Memory guards;
  bool searched_contact_step;
  Status status;
  Servo servo;
  VecX mean_reactions;
  double t0, trial_dt, adaptive_dt, flight_dt, contact_trial_dt, contact_seconds, kinetic;
  int solved_in_row, contact_solved_in_row, changes_without_progress;
  long halved, rejected, saturated;
  std::vector<std::pair<int, std::int64_t>> separated;
  std::vector<ChangeRecord> initial_changes;
  StepCounters step_counters;
  GuardCounters guard_counters;
  ContactStepCounters contact_counters;
};

std::shared_ptr<const Simulator::Snapshot> Simulator::save() {
  return std::make_shared<const Snapshot>(Snapshot{adaptive_start(Recording()),
                                                   integrator_.memory(),
                                                   contact_step_.memory(),
                                                   finder_.memory(),
                                                   guards_.memory(),
                                                   finder_.stepper() == &contact_step_,
                                                   status_,
                                                   servo_,
                                                   mean_reactions_,
                                                   t0_,
                                                   trial_dt_,
                                                   adaptive_dt_,
                                                   flight_dt_,
                                                   contact_trial_dt_,
                                                   contact_seconds_,
                                                   kinetic_,
                                                   solved_in_row_,
                                                   contact_solved_in_row_,
                                                   changes_without_progress_,
                                                   halved_,
                                                   rejected_,
                                                   saturated_,
                                                   separated_,
                                                   initial_changes_,
                                                   integrator_.counters,
                                                   guards_.counters,
                                                   contact_step_.counters});
}

void Simulator::restore(const Snapshot& s) {
  Recording none;
  return_to(s.start, none);
  status_ = s.status;
  servo_ = s.servo;
  apply_servo();
  mean_reactions_ = s.mean_reactions;
  t0_ = s.t0;
  trial_dt_ = s.trial_dt;
  adaptive_dt_ = s.adaptive_dt;
  flight_dt_ = s.flight_dt;
  contact_trial_dt_ = s.contact_trial_dt;
  contact_seconds_ = s.contact_seconds;
  kinetic_ = s.kinetic;
  solved_in_row_ = s.solved_in_row;
  contact_solved_in_row_ = s.contact_solved_in_row;
  changes_without_progress_ = s.changes_without_progress;
  halved_ = s.halved;
  rejected_ = s.rejected;
  saturated_ = s.saturated;
  separated_ = s.separated;
  initial_changes_ = s.initial_changes;
  update_persistent_guards();
  contact_step_.recall(s.contact_step);
  integrator_.recall(s.integrator);
  finder_.set_stepper(s.searched_contact_step ? static_cast<Stepper&>(contact_step_)
                                              : static_cast<Stepper&>(integrator_));
  finder_.recall(s.finder);
  guards_.recall(s.guards);
  integrator_.counters = s.step_counters;
  guards_.counters = s.guard_counters;
  contact_step_.counters = s.contact_counters;
}

}  // namespace contactvi

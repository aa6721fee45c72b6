// Simulator: saving all that the rest of a run depends on, and going back to it.
#include "run/simulator.hpp"

namespace contactvi {

struct Simulator::Snapshot {
  AdaptiveStart arc;
  Integrator::Memory integrator;
  ContactStep::Memory persistent;
  EventFinder::Memory finder;
  Guards::Memory guards;
  bool searched_persistent;
  Status status;
  Servo servo;
  VecX mean_reactions;
  double t0, trial, adaptive_h, flight_trial, contact_trial, contact_seconds, kinetic;
  int easy, contact_easy, without_progress;
  long halved, rejected, saturated;
  std::vector<std::pair<int, std::int64_t>> left;
  std::vector<ChangeRecord> begun;
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
                                                   trial_,
                                                   adaptive_h_,
                                                   flight_trial_,
                                                   contact_trial_,
                                                   contact_seconds_,
                                                   kinetic_,
                                                   easy_,
                                                   contact_easy_,
                                                   without_progress_,
                                                   halved_,
                                                   rejected_,
                                                   saturated_,
                                                   separated_,
                                                   begun_,
                                                   integrator_.counters,
                                                   guards_.counters,
                                                   contact_step_.counters});
}

void Simulator::restore(const Snapshot& s) {
  Recording none;
  go_back(s.arc, none);
  status_ = s.status;
  servo_ = s.servo;
  apply_servo();
  mean_reactions_ = s.mean_reactions;
  t0_ = s.t0;
  trial_ = s.trial;
  adaptive_h_ = s.adaptive_h;
  flight_trial_ = s.flight_trial;
  contact_trial_ = s.contact_trial;
  contact_seconds_ = s.contact_seconds;
  kinetic_ = s.kinetic;
  easy_ = s.easy;
  contact_easy_ = s.contact_easy;
  without_progress_ = s.without_progress;
  halved_ = s.halved;
  rejected_ = s.rejected;
  saturated_ = s.saturated;
  separated_ = s.left;
  begun_ = s.begun;
  sync_persistent();
  contact_step_.recall(s.persistent);
  integrator_.recall(s.integrator);
  finder_.set_stepper(s.searched_persistent ? static_cast<Stepper&>(contact_step_)
                                            : static_cast<Stepper&>(integrator_));
  finder_.recall(s.finder);
  guards_.recall(s.guards);
  integrator_.counters = s.step_counters;
  guards_.counters = s.guard_counters;
  contact_step_.counters = s.contact_counters;
}

}  // namespace contactvi

// Simulator: saving all that the rest of a run depends on, and going back to it.
#include "run/simulator.hpp"

namespace contactvi {

struct Simulator::Snapshot {
  ArcStart arc;
  Integrator::Memory integrator;
  HeldStep::Memory held;
  EventFinder::Memory finder;
  Guards::Memory guards;
  bool searched_held;
  Status status;
  Servo servo;
  VecX q_node, p_node, mean_reactions;
  double t0, trial, arc_h, flight_trial, held_trial, held_seconds, kinetic;
  int easy, held_easy, without_progress;
  long halved, rejected, saturated;
  std::vector<std::pair<int, std::int64_t>> left;
  std::vector<ChangeRecord> begun;
  StepCounters step_counters;
  GuardCounters guard_counters;
  HeldCounters held_counters;
};

std::shared_ptr<const Simulator::Snapshot> Simulator::save() {
  return std::make_shared<const Snapshot>(Snapshot{arc_start(Recording()),
                                                   integrator_.memory(),
                                                   held_.memory(),
                                                   finder_.memory(),
                                                   guards_.memory(),
                                                   finder_.stepper() == &held_,
                                                   status_,
                                                   servo_,
                                                   q_node_,
                                                   p_node_,
                                                   mean_reactions_,
                                                   t0_,
                                                   trial_,
                                                   arc_h_,
                                                   flight_trial_,
                                                   held_trial_,
                                                   held_seconds_,
                                                   kinetic_,
                                                   easy_,
                                                   held_easy_,
                                                   without_progress_,
                                                   halved_,
                                                   rejected_,
                                                   saturated_,
                                                   left_,
                                                   begun_,
                                                   integrator_.counters,
                                                   guards_.counters,
                                                   held_.counters});
}

void Simulator::restore(const Snapshot& s) {
  Recording none;
  go_back(s.arc, none);
  status_ = s.status;
  servo_ = s.servo;
  apply_servo();
  q_node_ = s.q_node;
  p_node_ = s.p_node;
  mean_reactions_ = s.mean_reactions;
  sequence_.constraint_impulses.setZero(s.arc.reactions.size());
  sequence_.drive_work = 0.0;
  t0_ = s.t0;
  trial_ = s.trial;
  arc_h_ = s.arc_h;
  flight_trial_ = s.flight_trial;
  held_trial_ = s.held_trial;
  held_seconds_ = s.held_seconds;
  kinetic_ = s.kinetic;
  easy_ = s.easy;
  held_easy_ = s.held_easy;
  without_progress_ = s.without_progress;
  halved_ = s.halved;
  rejected_ = s.rejected;
  saturated_ = s.saturated;
  left_ = s.left;
  begun_ = s.begun;
  sync_held();
  held_.recall(s.held);
  integrator_.recall(s.integrator);
  finder_.set_stepper(s.searched_held ? static_cast<Stepper&>(held_) : static_cast<Stepper&>(integrator_));
  finder_.recall(s.finder);
  guards_.recall(s.guards);
  integrator_.counters = s.step_counters;
  guards_.counters = s.guard_counters;
  held_.counters = s.held_counters;
}

}  // namespace contactvi

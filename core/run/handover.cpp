// Simulator: what bodies bring along when they become an island, and what they take with them when it ends.
#include "run/simulator.hpp"

namespace contactvi {

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
  to.dense = state_.dense;
  to.impulses = dense_step_.memory().impulses;
  to.change = dense_step_.memory().change;
  to.change_h = dense_step_.memory().h;
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
  s.dense = from.dense;
  s.impacts = s.rejected = s.dense_steps = 0;
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
  DenseStep::Memory dense = fresh.dense_step;
  dense.impulses = from.impulses;
  dense.change = from.change;
  dense.h = from.change_h;
  dense_step_.recall(dense);
  for (int g : from.touching) finder_.set_touching(g, true);
  for (int g : from.exempt) finder_.exempt(g);
  law_->start_run(free_state(), s.reference);
}

void Simulator::forget_counts() {
  state_.impacts = state_.dense_steps = state_.control.halved = state_.actuators.saturated = 0;
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

}  // namespace contactvi

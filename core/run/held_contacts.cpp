// Simulator: persistent contacts in smooth steps of any order (contact_modes.hpp).
//
// Where a smooth step cannot hold them, because it is not solved, or a feature changes in it, it is halved; what is as
// short as a contact step is left to these for a while. They take impulses inside of a step as they come.
#include <algorithm>
#include <cmath>

#include "run/simulator.hpp"

namespace contactvi {

namespace {
// Lengths of contact steps. From a smooth step that fails and is shorter than the first number a run that chooses its
// steps learns nothing. One that is shorter than the second number is not halved any more: a contact step, of order 2,
// costs more digits than some halvings cost time.
constexpr double kAsContactStep = 2.0, kShortest = 1.0 / 16;
constexpr double kLongestSpan = 64.0;  // lengths of contact steps that are made one after the other
// Of the energies at both ends: a step that is off by more has not resolved its motion. Methods of order 4 with steps
// of half a radian are off by some 1e-4. And what rounding makes.
constexpr double kResolved = 1e-3, kEnergyRounding = 1e-12;
constexpr double kAtOnce = 1e-9;  // [s] of 1 s + t: spans follow each other
}  // namespace

bool Simulator::may_hold_contacts(double time) const {
  return keeps_constraints_ && time >= state_.contact_steps.time - kAtOnce * (1.0 + std::abs(time));
}

bool Simulator::is_as_contact_step(double h) const { return h <= kAsContactStep * contact_dt(); }

bool Simulator::leave_to_contact_steps(double time) {
  modes_.end_step();
  integrator_.forget();
  contact_step_.invalidate();
  ContactStepsUntil& until = state_.contact_steps;
  const bool at_once = time - until.time <= until.span;
  until.span = at_once ? std::min(2.0 * until.span, kLongestSpan * contact_dt()) : contact_dt();
  until.time = time + until.span;
  return true;
}

// A smooth step of length h was not taken.
bool Simulator::shorten_step(double h, double time) {
  if (user_function_failed(time)) return false;
  if (modes_.active() && h <= kShortest * contact_dt()) return leave_to_contact_steps(time);
  modes_.end_step();
  state_.control.halve_free(h);
  return true;
}

// Of a step just solved, from the state with the velocity v_ to q1_, p1_: whether its energy changes by its work alone,
// but for an error that the motion it resolves would not have.
bool Simulator::held_step_keeps_energy() {
  const double T0 = 0.5 * state_.p.dot(v_), T1 = 0.5 * p1_.dot(integrator_.constraints()->end_velocity());
  const double V0 = potential(state_.q), V1 = potential(q1_);
  const double change = T1 + V1 - T0 - V0 - integrator_.work() - modes_.friction_work();
  return std::abs(change) <=
         kResolved * (T0 + T1 + std::abs(V1 - V0)) + kEnergyRounding * (std::abs(V0) + std::abs(V1));
}

// switches: whether it ends where the last search has found something to end.
void Simulator::keep_held_step(bool switches) {
  kept_held_steps_.push_back(held_step_record(integrator_, state_.q, state_.p));
  if (!modes_.active()) return;
  HeldStepRecord& record = kept_held_steps_.back();
  record.angles = integrator_.constraints()->slip_angles();
  record.slips = integrator_.constraints()->slips();
  record.contacts = contact_step_.contacts();
  record.joints = contact_step_.friction_joints();
  const int function = switches ? switches_.which() - branches_.count() : -1;
  if (function < 0) return;
  const ContactModes::Ending ending = modes_.ending(function);
  const bool of_joint = ending.end == ContactModes::End::kJointSlips || ending.end == ContactModes::End::kJointSticks;
  record.ended = static_cast<int>(ending.contact + (of_joint ? record.contacts.size() : 0));
  switch (ending.end) {
    case ContactModes::End::kRelease:
      record.ending = HeldStepEnd::kRelease;
      break;
    case ContactModes::End::kSlip:
    case ContactModes::End::kJointSlips:
      record.ending = HeldStepEnd::kSlip;
      break;
    case ContactModes::End::kStick:
    case ContactModes::End::kJointSticks:
      record.ending = HeldStepEnd::kRest;
      break;
    case ContactModes::End::kFeature:
      record.ending = HeldStepEnd::kBorder;
      record.ended = static_cast<int>(modes_.point_of(ending));
      break;
  }
}

// What the function of the modes says at a state that ends a step or begins one happens to the contacts.
void Simulator::change_contact(int function, double time, const VecX& v, bool moved, Recording& recording) {
  const ContactModes::Ending ending = modes_.ending(function);
  switch (ending.end) {
    case ContactModes::End::kJointSlips:
      modes_.begin_joint_slip(ending.contact);
      break;
    case ContactModes::End::kJointSticks:
      contact_step_.invalidate();  // it may turn back: that is decided at the start of the next step
      break;
    case ContactModes::End::kRelease:
      modes_.end_step();
      contacts_.release(static_cast<int>(ending.contact), time, modes_.tau(), recording);
      if (!moved) finder_.forget_step();
      break;
    case ContactModes::End::kSlip:
      modes_.begin_slip(ending.contact, time, recording);
      break;
    case ContactModes::End::kStick:
      modes_.come_to_rest(ending.contact, v, time, recording);
      break;
    case ContactModes::End::kFeature:
      if (modes_.ends_point(ending)) contacts_.leave(modes_.point_of(ending), v, time, recording);
      break;
  }
}

}  // namespace contactvi

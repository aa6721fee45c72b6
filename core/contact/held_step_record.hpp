// A smooth step of any order that kept rows, as it was taken, with all that its derivative needs. Engine coordinates.
#pragma once

#include <vector>

#include "contact/friction_joint.hpp"
#include "contact/persistent_contact.hpp"
#include "step/integrator.hpp"

namespace contactvi {

// What ended a held step: the length it was given, or an impact; a slip that comes to rest; a contact that is released;
// a slip that begins; a contact that comes to another feature. The numbers are those of stored runs.
enum class HeldStepEnd { kGiven = 0, kRest = 1, kRelease = 2, kSlip = 3, kBorder = 4 };

struct HeldStepRecord {
  double t, h;  // start and length [s]
  VecX q0, p0, v1;
  MatX rates;        // of the charts at its stages, (nv, s)
  MatX lambda = {};  // impulses of its rows at its nodes, (rows, s + 1)
  MatX angles = {};  // directions of the slips there, from the first tangents, (sliding contacts, s + 1)
  MatX slips = {};   // and the speeds along them [m/s]
  // As they are before the step, which are those of the rows after the constraints'.
  std::vector<PersistentContact> contacts = {};
  std::vector<FrictionJoint> joints = {};
  HeldStepEnd ending = HeldStepEnd::kGiven;
  int ended = -1;  // whose slip or contact: contacts, then joints; else -1
  // Files of older versions do not keep what friction that varies, moving surfaces and adhesion need.
  bool lacks_laws = false;
};

// The step from (q0, p0) that was just solved, without contacts.
inline HeldStepRecord held_step_record(Integrator& solved, const VecX& q0, const VecX& p0) {
  const StageConstraints& rows = *solved.constraints();
  HeldStepRecord record{solved.time(), solved.length(), q0, p0, rows.end_velocity(), solved.rates()};
  record.lambda = rows.node_impulses();
  return record;
}

}  // namespace contactvi

// A degree of freedom with joint friction, and its state from step to step.
#pragma once

#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

struct FrictionJoint {
  int dof, iq;   // iq: -1 for a joint with more than one coordinate in q
  double limit;  // friction force or torque [N; N m]
  bool anchored = false;
  double anchor = 0, reference = 0;  // coordinates: where it sticks, and from which the displacement of a step counts
  double speed = 0;                  // at the start of the step; 0 where it sticks
  // In smooth steps: whether it sticks, and else the sign of its slip.
  bool sticks = false;
  double heading = 0;
};

// At a state: joints that do not move stick, where they are or where they stuck before; the others slide.
void settle_joints(std::vector<FrictionJoint>& joints, const VecX& q, const VecX& v);
// Those that stick and would accelerate by more than `begins` with all the friction that they may have begin to slide.
// a: of the joints.
void begin_joint_slips(std::vector<FrictionJoint>& joints, const VecX& a, double begins);
// Of the largest acceleration: one that begins a slip. Where contacts share a load the forces agree to 1e-7.
constexpr double kBegins = 1e-7;

}  // namespace contactvi

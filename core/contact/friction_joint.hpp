// A degree of freedom with joint friction, and its state from step to step.
#pragma once

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

}  // namespace contactvi

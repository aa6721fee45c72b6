#include "contact/friction_joint.hpp"

#include <cmath>

#include "base/tolerances.hpp"

namespace contactvi {

void settle_joints(std::vector<FrictionJoint>& joints, const VecX& q, const VecX& v) {
  const double still = kStill * (1.0 + v.cwiseAbs().maxCoeff());
  for (FrictionJoint& joint : joints) {
    joint.sticks = std::abs(v[joint.dof]) <= still;
    joint.heading = joint.sticks ? 0.0 : std::copysign(1.0, v[joint.dof]);
    joint.anchored = joint.anchored && joint.sticks;
    if (joint.sticks && !joint.anchored && joint.iq >= 0) {
      joint.anchor = q[joint.iq];
      joint.anchored = true;
    }
  }
}

void begin_joint_slips(std::vector<FrictionJoint>& joints, const VecX& a, double begins) {
  for (std::size_t k = 0; k < joints.size(); ++k) {
    FrictionJoint& joint = joints[k];
    const double along = a[static_cast<Eigen::Index>(k)];
    if (!joint.sticks || !(std::abs(along) > begins)) continue;
    joint.sticks = joint.anchored = false;
    joint.heading = std::copysign(1.0, along);
  }
}

}  // namespace contactvi

#include "model/placement.hpp"

#include <cmath>

namespace contactvi {

Placements::Placements(const Tree& tree)
    : R(tree.joints.size()), r(tree.joints.size()), R_W(tree.joints.size()), p_W(tree.joints.size()) {}

namespace {

// R = R_PJ Rz(angle): only two columns change.
inline void turn_about_z(const Mat3& R_PJ, double c, double s, Mat3& R) {
  R.col(0) = c * R_PJ.col(0) + s * R_PJ.col(1);
  R.col(1) = c * R_PJ.col(1) - s * R_PJ.col(0);
  R.col(2) = R_PJ.col(2);
}

inline void place_joint(const Joint& joint, const double* q, Mat3& R, Vec3& r) {
  switch (joint.type) {
    case JointType::kRevolute:
      turn_about_z(joint.R_PJ, std::cos(q[0]), std::sin(q[0]), R);
      r = joint.p_PJ;
      break;
    case JointType::kContinuous:
      turn_about_z(joint.R_PJ, q[0], q[1], R);
      r = joint.p_PJ;
      break;
    case JointType::kPrismatic:
      R = joint.R_PJ;
      r = joint.p_PJ + q[0] * joint.R_PJ.col(2);
      break;
    case JointType::kHelical:
      turn_about_z(joint.R_PJ, std::cos(q[0]), std::sin(q[0]), R);
      r = joint.p_PJ + (joint.pitch * q[0]) * joint.R_PJ.col(2);
      break;
    case JointType::kTranslation:
      R = joint.R_PJ;
      r = joint.p_PJ + joint.R_PJ * Vec3(q[0], q[1], q[2]);
      break;
    case JointType::kSpherical:
      R.noalias() = joint.R_PJ * Quat(q[3], q[0], q[1], q[2]).toRotationMatrix();
      r = joint.p_PJ;
      break;
  }
}

}  // namespace

void place_body(const Tree& tree, int i, const VecCRef& q, Placements& at) {
  const Joint& joint = tree.joints[i];
  place_joint(joint, q.data() + joint.iq, at.R[i], at.r[i]);
  if (joint.parent < 0) {
    at.R_W[i] = at.R[i];
    at.p_W[i] = at.r[i];
  } else {
    at.R_W[i].noalias() = at.R_W[joint.parent] * at.R[i];
    at.p_W[i] = at.p_W[joint.parent] + at.R_W[joint.parent] * at.r[i];
  }
}

void place(const Tree& tree, const VecCRef& q, Placements& at) {
  for (int i = 0; i < static_cast<int>(tree.joints.size()); ++i) place_body(tree, i, q, at);
}

double gravity_potential(const Tree& tree, const Placements& at) {
  double potential = 0;
  for (std::size_t i = 0; i < tree.joints.size(); ++i) {
    const Joint& joint = tree.joints[i];
    potential -= tree.gravity.dot(joint.mass * at.p_W[i] + at.R_W[i] * joint.first_moment);
  }
  return potential;
}

}  // namespace contactvi

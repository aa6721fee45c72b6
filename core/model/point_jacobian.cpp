#include "model/point_jacobian.hpp"

namespace contactvi {

void add_point_row(const Tree& tree, const Placements& at, int body, const Vec3& x, const Vec3& n, double sign,
                   VecRef W) {
  for (int j = body; j >= 0; j = tree.joints[j].parent) {
    const Joint& joint = tree.joints[j];
    const Mat3& R = at.R_W[j];
    switch (joint.type) {
      case JointType::kRevolute:
      case JointType::kContinuous:
        W[joint.iv] += sign * R.col(2).dot((x - at.p_W[j]).cross(n));
        break;
      case JointType::kPrismatic:
        W[joint.iv] += sign * R.col(2).dot(n);
        break;
      case JointType::kHelical:
        W[joint.iv] += sign * R.col(2).dot((x - at.p_W[j]).cross(n) + joint.pitch * n);
        break;
      case JointType::kTranslation:
        W.segment<3>(joint.iv) += sign * (R.transpose() * n);
        break;
      case JointType::kSpherical:
        W.segment<3>(joint.iv) += sign * (R.transpose() * (x - at.p_W[j]).cross(n));
        break;
    }
  }
}

void add_turn_row(const Tree& tree, const Placements& at, int body, const Vec3& n, double sign, VecRef W) {
  for (int j = body; j >= 0; j = tree.joints[j].parent) {
    const Joint& joint = tree.joints[j];
    switch (joint.type) {
      case JointType::kRevolute:
      case JointType::kContinuous:
      case JointType::kHelical:
        W[joint.iv] += sign * at.R_W[j].col(2).dot(n);
        break;
      case JointType::kSpherical:
        W.segment<3>(joint.iv) += sign * (at.R_W[j].transpose() * n);
        break;
      default:
        break;
    }
  }
}

}  // namespace contactvi

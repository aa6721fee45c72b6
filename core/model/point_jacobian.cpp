#include "model/point_jacobian.hpp"

namespace contactvi {

namespace {

// The part of one joint, whose axes are R, in the row W along n; d: from the joint to the point.
inline void add_joint(const Joint& joint, const Mat3& R, const Vec3& d, const Vec3& n, double sign, double* W) {
  switch (joint.type) {
    case JointType::kRevolute:
    case JointType::kContinuous:
      W[joint.iv] += sign * R.col(2).dot(d.cross(n));
      break;
    case JointType::kPrismatic:
      W[joint.iv] += sign * R.col(2).dot(n);
      break;
    case JointType::kHelical:
      W[joint.iv] += sign * R.col(2).dot(d.cross(n) + joint.pitch * n);
      break;
    case JointType::kTranslation:
      Eigen::Map<Vec3>(W + joint.iv) += sign * (R.transpose() * n);
      break;
    case JointType::kSpherical:
      Eigen::Map<Vec3>(W + joint.iv) += sign * (R.transpose() * d.cross(n));
      break;
  }
}

}  // namespace

void add_point_row(const Tree& tree, const Placements& at, int body, const Vec3& x, const Vec3& n, double sign,
                   VecRef W) {
  for (int j = body; j >= 0; j = tree.joints[j].parent)
    add_joint(tree.joints[j], at.R_W[j], x - at.p_W[j], n, sign, W.data());
}

void add_point_rows(const Tree& tree, const Placements& at, int body, const Vec3& x, const Vec3* directions,
                    double sign, Eigen::Ref<MatX> W) {
  for (int j = body; j >= 0; j = tree.joints[j].parent) {
    const Vec3 d = x - at.p_W[j];
    for (Eigen::Index k = 0; k < W.cols(); ++k)
      add_joint(tree.joints[j], at.R_W[j], d, directions[k], sign, W.col(k).data());
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

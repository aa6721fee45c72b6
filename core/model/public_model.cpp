#include "model/public_model.hpp"

#include <cmath>
#include <utility>

#include "base/error.hpp"

namespace contactvi {

namespace {

std::pair<int, int> sizes(PublicJointType type) {
  switch (type) {
    case PublicJointType::kContinuous:
      return {2, 1};
    case PublicJointType::kPlanar:
      return {4, 3};
    case PublicJointType::kTranslation:
      return {3, 3};
    case PublicJointType::kSpherical:
      return {4, 3};
    case PublicJointType::kFreeFlyer:
      return {7, 6};
    default:
      return {1, 1};
  }
}

// Rotation about a unit axis.
Mat3 turned(const Vec3& axis, double cosine, double sine) {
  const Mat3 K = skew(axis);
  return Mat3::Identity() + sine * K + (1.0 - cosine) * K * K;
}

Mat3 turned(const double* xyzw) { return Quat(xyzw[3], xyzw[0], xyzw[1], xyzw[2]).toRotationMatrix(); }

}  // namespace

PublicModel::PublicModel(const Vec3& gravity_, VecX armature_, VecX lower_, VecX upper_)
    : gravity(gravity_), armature(std::move(armature_)), lower(std::move(lower_)), upper(std::move(upper_)) {
  PublicJoint world{};
  world.subspace.setZero();
  world.R_PJ.setIdentity();
  world.p_PJ.setZero();
  world.centre.setZero();
  world.inertia.setZero();
  world.name = "universe";
  joints.push_back(std::move(world));
}

void PublicModel::add_joint(PublicJointType type, int parent, const Vec6& subspace, const Mat3& R_PJ, const Vec3& p_PJ,
                            double mass, const Vec3& centre, const Mat3& inertia, std::string name) {
  const auto [size_q, size_v] = sizes(type);
  if (parent < 0 || parent >= static_cast<int>(joints.size()))
    throw Error("joint " + name + " comes before its parent");
  if (nq + size_q > lower.size() || lower.size() != upper.size() || nv + size_v > armature.size())
    throw Error("a joint more than the arrays of the model are for");
  joints.push_back(
      {type, parent, nq, size_q, nv, size_v, subspace, R_PJ, p_PJ, mass, centre, inertia, std::move(name)});
  nq += size_q;
  nv += size_v;
}

Twist joint_twist(const PublicJoint& joint, const double* v) {
  const Vec3 none = Vec3::Zero();
  switch (joint.type) {
    case PublicJointType::kRevolute:
    case PublicJointType::kContinuous:
    case PublicJointType::kPrismatic:
    case PublicJointType::kHelical:
      return {v[0] * joint.subspace.tail<3>(), v[0] * joint.subspace.head<3>()};
    case PublicJointType::kPlanar:
      return {Vec3(0, 0, v[2]), Vec3(v[0], v[1], 0)};
    case PublicJointType::kTranslation:
      return {none, Vec3(v[0], v[1], v[2])};
    case PublicJointType::kSpherical:
      return {Vec3(v[0], v[1], v[2]), none};
    case PublicJointType::kFreeFlyer:
      return {Vec3(v[3], v[4], v[5]), Vec3(v[0], v[1], v[2])};
  }
  return {none, none};
}

Twist joint_axis(const PublicJoint& joint, int dof) {
  double unit[6] = {0, 0, 0, 0, 0, 0};
  unit[dof] = 1.0;
  return joint_twist(joint, unit);
}

void place_joint(const PublicJoint& joint, const VecCRef& q, Mat3& R, Vec3& p) {
  const double* x = q.data() + joint.iq;
  const Vec3 along = joint.subspace.head<3>(), axis = joint.subspace.tail<3>();
  R = joint.R_PJ;
  p = joint.p_PJ;
  switch (joint.type) {
    case PublicJointType::kRevolute:
      R *= turned(axis, std::cos(x[0]), std::sin(x[0]));
      break;
    case PublicJointType::kContinuous:
      R *= turned(axis, x[0], x[1]);
      break;
    case PublicJointType::kPrismatic:
      p += R * (x[0] * along);
      break;
    case PublicJointType::kHelical:
      p += R * (x[0] * along);
      R *= turned(axis, std::cos(x[0]), std::sin(x[0]));
      break;
    case PublicJointType::kPlanar:
      p += R * Vec3(x[0], x[1], 0);
      R *= turned(Vec3::UnitZ(), x[2], x[3]);
      break;
    case PublicJointType::kTranslation:
      p += R * Vec3(x[0], x[1], x[2]);
      break;
    case PublicJointType::kSpherical:
      R *= turned(x);
      break;
    case PublicJointType::kFreeFlyer:
      p += R * Vec3(x[0], x[1], x[2]);
      R *= turned(x + 3);
      break;
  }
}

}  // namespace contactvi

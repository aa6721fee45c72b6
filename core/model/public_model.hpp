// A model as users hold it: joints, bodies and coordinates are those of a pin.Model, whose numbers cross one by one, so
// that the engine needs none of Pinocchio's code. The engine's tree is made of it (load.cpp).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

using Vec6 = Eigen::Matrix<double, 6, 1>;
using Mat6X = Eigen::Matrix<double, 6, Eigen::Dynamic>;

enum class PublicJointType : std::uint8_t {
  kRevolute,     // q: angle about the axis
  kContinuous,   // q: (cos, sin) of the angle about the axis
  kPrismatic,    // q: displacement along the axis
  kHelical,      // q: angle about the axis, displacement pitch * q along it
  kPlanar,       // q: x, y, (cos, sin) of the angle about z; v: velocity of the origin and rate of the angle
  kTranslation,  // q: displacement
  kSpherical,    // q: quaternion (x, y, z, w); v: angular velocity in the body frame
  kFreeFlyer,    // q: position, quaternion (x, y, z, w); v: body twist, linear part first
};

struct PublicJoint {
  PublicJointType type;
  int parent;  // number of the joint that carries it, 0: the world
  int iq, nq;  // first index and count in q
  int iv, nv;  // first index and count in v
  // What a unit of the velocity of a joint with one degree of freedom is (linear, angular), in its frame.
  Vec6 subspace;
  Mat3 R_PJ;  // joint frame at q = 0 in that of the parent
  Vec3 p_PJ;
  double mass;   // of the body that it moves
  Vec3 centre;   // of mass, joint frame
  Mat3 inertia;  // rotational, about the centre of mass, in the axes of the joint frame
  std::string name;
};

struct PublicModel {
  PublicModel(const Vec3& gravity, VecX armature, VecX lower, VecX upper);

  // Appends a joint whose parent is there.
  void add_joint(PublicJointType type, int parent, const Vec6& subspace, const Mat3& R_PJ, const Vec3& p_PJ,
                 double mass, const Vec3& centre, const Mat3& inertia, std::string name);

  int nq = 0, nv = 0;
  Vec3 gravity;
  VecX armature;                    // nv, added to the diagonal of M
  VecX lower, upper;                // nq, position limits
  std::vector<PublicJoint> joints;  // parents before children, the first one is the world
};

// What a joint adds to the twist of its parent, in its own frame, for its velocity v (joint.nv), and for a unit of one
// of its velocities.
Twist joint_twist(const PublicJoint& joint, const double* v);
Twist joint_axis(const PublicJoint& joint, int dof);

// Its frame in that of its parent at the model's configuration q (nq).
void place_joint(const PublicJoint& joint, const VecCRef& q, Mat3& R, Vec3& p);

}  // namespace contactvi

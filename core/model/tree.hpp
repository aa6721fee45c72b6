// The constant model: kinematic tree with the six joint types that the integrator steps, springs, damping.
//
// Built once by load.cpp from the public model. Two changes of coordinates happen there and nowhere else:
//  - a free-flyer becomes a translation followed by a spherical joint, a planar joint two prismatic ones and a
//    continuous one (R^3 x SO(3), R^2 x SO(2)): on SE(3) exp couples spin with translation, and the flight of a
//    spinning ball is no parabola;
//  - every 1-dof joint's axis is the z axis of its body, so that its motion subspace is one number.
// Configurations keep Pinocchio's numbers; velocities and momenta of split joints differ (see coordinates.hpp).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "base/numerics.hpp"
#include "model/elements.hpp"
#include "model/followers.hpp"

namespace contactvi {

enum class JointType : std::uint8_t {
  kRevolute,     // q: angle about z
  kContinuous,   // q: (cos, sin) of the angle about z
  kPrismatic,    // q: displacement along z
  kHelical,      // q: angle about z, displacement pitch * q along z
  kTranslation,  // q: displacement in the joint frame
  kSpherical,    // q: quaternion (x, y, z, w); v: angular velocity in the body frame
};

struct Joint {
  JointType type;
  int parent;    // joint index, -1: world
  int iq, nq;    // first index and count in q
  int iv, nv;    // first index and count in v
  double pitch;  // [m/rad], helical joints
  Mat3 R_PJ;     // joint frame in the parent body's frame
  Vec3 p_PJ;
  double mass;        // of the body that this joint moves
  Vec3 first_moment;  // mass times centre of mass, body frame
  Mat3 inertia;       // rotational inertia about the body frame's origin
  double stiffness;   // [N/m] or [N m/rad], isotropic over the joint's dofs
  std::string name;
};

struct JointLimit {
  int joint;         // index in Tree::joints
  int source_joint;  // index in the Pinocchio model, for names
  bool upper;
  double bound;
  double restitution;
};

// A joint of the public model whose velocity differs from the engine's.
struct SplitJoint {
  bool planar;
  int iq;  // first index of the public joint in q
  int iv;
};

struct Tree {
  int nq = 0, nv = 0;
  Vec3 gravity = Vec3::Zero();
  std::vector<Joint> joints;    // parents before children
  std::vector<int> dof_joint;   // nv
  std::vector<int> dof_parent;  // nv: the next dof towards the root, -1 at a root
  VecX armature;                // nv, added to the diagonal of M
  VecX damping;                 // nv
  VecX rest;                    // nq, configuration at which the springs are relaxed
  bool has_springs = false, has_damping = false;
  std::vector<SplitJoint> split;
  std::vector<JointLimit> limits;
  Elements elements;
  std::vector<Follower> followers;  // joints that are coupled to others, by coupling
  std::vector<Coupling> couplings;
  // Part of the armature (nv,), or empty: S^T diag S = 0 of it. It lends links that have no mass of their own what
  // their leaders have, so that M has an inverse; the motion does not know of it.
  VecX lent_armature;
  // For each of Pinocchio's joints: the engine joint that moves its body (the last one of a split joint), and the
  // rotation of the public joint frame in that body's frame.
  std::vector<int> body_of_source;
  std::vector<Mat3> R_body_source;
};

// Sets mass, first moment and inertia of the body of a joint, from those in a frame that A turns the body frame into:
// x = A x_body; the centre of mass and the rotational inertia about it.
void set_body(Joint& joint, double mass, const Vec3& centre, const Mat3& about_com, const Mat3& A);
// Sets has_springs and has_damping.
void find_springs_and_damping(Tree& tree);

// q1 = q (+) factor w: addition on vector joints, rotation on (cos, sin) and quaternions, which are renormalised. q1
// may be q. For one joint w has the numbers of that joint alone.
void integrate_joint(const Joint& joint, const VecCRef& q, const double* w, VecRef q1);
void integrate(const Tree& tree, const VecCRef& q, const VecCRef& w, double factor, VecRef q1);

// Norm of the tangent difference of two configurations [m, rad]: positions and angles of joints, and the angles of the
// turns between the two, which follow from chords and so lose no digits where they are small.
double configuration_distance(const Tree& tree, const VecCRef& a, const VecCRef& b);

// value - q of a joint with one degree of freedom [rad; m]; on (cos, sin) joints the shorter way round.
double joint_error(const Joint& joint, const VecCRef& q, double value);

// Tangent vector from the springs' rest configuration to q for one joint, shape (nv of the joint,) in the first
// entries.
Vec3 spring_deflection(const Tree& tree, const Joint& joint, const VecCRef& q);

// Energy of the joint springs at q [J], and their dV/dq added to dV, shape (nv,).
double spring_potential(const Tree& tree, const VecCRef& q);
void add_spring_forces(const Tree& tree, const VecCRef& q, VecRef dV);

}  // namespace contactvi

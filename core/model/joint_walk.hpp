// The motion of a model in its public coordinates, by passes over its joints: up from the world for places, twists and
// accelerations, down again for forces. Time and memory are those of the number of joints, of its square for what is a
// matrix (Featherstone, Rigid Body Dynamics Algorithms, 2008, tables 5.1 and 6.2).
//
// Twists, accelerations (spatial, the derivatives of twists) and forces of a joint are in its own frame: about the
// world's origin the inertia of a small body far from there would lose its digits.
#pragma once

#include <vector>

#include "model/public_model.hpp"

namespace contactvi {

struct JointMotion {
  Mat3 R_PJ;  // its frame in that of its parent
  Vec3 p_PJ;
  Mat3 R_WJ;  // and in the world
  Vec3 p_WJ;
  Twist twist, acceleration;
};

// The places of all joints at q (nq,), at rest; the world is the first one.
std::vector<JointMotion> joint_places(const PublicModel& model, const VecCRef& q);
// The whole motion at q (nq,), v (nv,) for dv/dt = 0, where the world accelerates by `world` [m/s^2].
std::vector<JointMotion> joint_motions(const PublicModel& model, const VecCRef& q, const VecCRef& v, const Vec3& world);

// Jacobian (6, nv) of the twist of a joint's frame at these places.
Mat6X joint_jacobian(const PublicModel& model, const std::vector<JointMotion>& places, int joint);

// Coriolis, centrifugal and gravity forces, (nv,).
VecX bias_forces(const PublicModel& model, const VecCRef& q, const VecCRef& v);

// M(q), (nv, nv).
MatX mass_matrix(const PublicModel& model, const VecCRef& q);

}  // namespace contactvi

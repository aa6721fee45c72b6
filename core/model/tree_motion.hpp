// The motion of a tree of bodies and its derivatives, by passes over its joints, in public coordinates.
//
// Here twists and forces are vectors (linear, angular) in world axes about the world's origin. With the twist V and the
// acceleration A of the body that carries the joint of dof i, a dof moves all that its joint carries by S_i; along it
//
//   psi = V x S_i,    psi' = A x S_i + V x psi,    S_i' = V_i x S_i,
//
// V_i the twist of its own joint, are what the derivatives are made of (Singh, Russell and Wensing, Efficient
// analytical derivatives of rigid-body dynamics using spatial vector algebra, 2022). Motion subspaces have to be
// constant in the frame of the body that the joint moves, as those of all public joints are.
#pragma once

#include <vector>

#include "model/joint_walk.hpp"

namespace contactvi {

using Mat3X = Eigen::Matrix<double, 3, Eigen::Dynamic>;

// Place, velocity and acceleration of a point, and derivatives (3, nv) in q, v and dv/dt; world axes.
struct PointMotion {
  Vec3 place, velocity, acceleration;
  Mat3X J, velocity_q, acceleration_q, acceleration_v;
};

class TreeMotion {
 public:
  // At q (nq,), v (nv,), a (nv,) = dv/dt. The model has to outlive it.
  TreeMotion(const PublicModel& model, const VecCRef& q, const VecCRef& v, const VecCRef& a);

  const PublicModel& model() const { return model_; }
  const Mat3& rotation(int joint) const { return places_[joint].R_WJ; }

  // Of a point [m] of a body, given in the frame of its joint; 0: of the world.
  PointMotion point(int joint, const Vec3& x) const;

  // d(J^T force)/dq of a point's Jacobian J at a constant force [N], world axes, (nv, nv).
  MatX turned_force(int joint, const Vec3& x, const Vec3& force) const;

  // Derivatives in q and v of M a + b at a constant a, (nv, nv) each.
  void force_derivatives(MatX& by_q, MatX& by_v) const;

 private:
  // The dofs that move the body of a joint, joint by joint down to the world.
  std::vector<int> dofs_below(int joint) const;

  const PublicModel& model_;
  std::vector<JointMotion> places_;
  std::vector<int> joint_of_dof_;
  Mat6X twists_, accelerations_;       // of each joint
  Mat6X S_, psi_, psi_rate_, S_rate_;  // of each dof
};

}  // namespace contactvi

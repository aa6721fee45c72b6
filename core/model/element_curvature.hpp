// Second derivatives of the elements' forces F (forces.hpp): how the gradient of f_bar . F(q, v) changes along a
// direction, for a constant f_bar. Engine coordinates; the gradient in q is dual to tangent vectors, as is its change
// along the body-fixed direction.
//
// f_bar . F is the power of the forces on the motion f_bar. Of that motion and of v the points to which forces are
// applied have velocities; the gradient follows from those in the points' places and velocities, once down the tree.
// All of it is computed with dual numbers, whose derivatives are those along the direction.
//
// Functions of the user have no second derivatives, and are left out.
#pragma once

#include <vector>

#include "base/dual_number.hpp"
#include "model/body_twists.hpp"

namespace contactvi {

// Velocity of a body about the world's origin.
struct DualTwist {
  Dual3 ang, lin;
};

// A point of a body, its place and its velocities under two motions, and gradients in them.
struct MovingPoint {
  Dual3 x, v, u;
};

// The bodies at a configuration that moves along a direction, under two motions v and u.
class MovingBodies {
 public:
  explicit MovingBodies(const Tree& tree);

  // dq: the direction; v and u: the motions, whose derivatives are along it; (nv,) each.
  void take(const VecCRef& q, const VecCRef& dq, const DualX& v, const DualX& u);
  DualMat3 axes(const BodyFrame& frame) const;
  MovingPoint point(int body, const Vec3& p_B) const;
  const DualTwist& of_u(int body) const { return motion_[1][body]; }
  // W += n^T J(x): the velocity along n of the point x of a body.
  void add_row(int body, const Dual3& x, const Dual3& n, DualX& W) const;
  // Adds, from the gradients in the place of a point and in its velocities, those in q and in v (nv,).
  void add_point(int body, const MovingPoint& at, const MovingPoint& bar, DualX& lq, DualX& lv) const;
  // From the gradients in the angular velocity of u, and in a turn of the body.
  void add_turn(int body, const Dual3& of_spin, const Dual3& of_turn, DualX& lq) const;

 private:
  DualTwist axis(int joint, int d) const;

  const Tree* tree_;
  BodyTwists bodies_;
  std::vector<DualMat3> R_;
  std::vector<Dual3> p_;
  std::vector<DualTwist> motion_[2];  // of v and of u
};

class ElementCurvature {
 public:
  explicit ElementCurvature(const Tree& tree);

  bool any() const { return any_; }
  // Adds the changes of the gradients of f_bar . F(t, q, v) in q and v along (dq, dv), (nv,) each.
  void add(double t, const VecCRef& q, const VecCRef& v, const VecCRef& dq, const VecCRef& dv, const VecCRef& f_bar,
           VecRef lq, VecRef lv);

 private:
  void add_spring(const PathSpring& spring);
  void add_wrench(double t, const AppliedWrench& wrench);

  const Tree* tree_;
  bool any_;
  MovingBodies bodies_;
  DualX v_, u_, lq_, lv_;
  std::vector<MovingPoint> points_;
};

}  // namespace contactvi

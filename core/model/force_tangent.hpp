// Derivatives of the elements' forces (forces.hpp) along a direction of configuration and velocity. Engine coordinates.
//
// A force on a body is a wrench W about the world's origin; joint j feels S_j . W, S_j its axes in the world, which
// move with its body: dS_j = V_j x S_j, V_j the body's twist along the direction.
#pragma once

#include <vector>

#include "model/placement.hpp"

namespace contactvi {

class ForceTangent {
 public:
  explicit ForceTangent(const Tree& tree);

  bool any() const { return any_; }
  // df += the derivative at (t, q, v) along (dq, dv), all of shape (nv,) but q (nq,).
  void add(double t, const VecCRef& q, const VecCRef& v, const VecCRef& dq, const VecCRef& dv, VecRef df);

 private:
  struct Point {
    Vec3 x, speed, moved, speed_moved;  // position, velocity, and their derivatives
  };
  void place_twists(const VecCRef& v, const VecCRef& dq, const VecCRef& dv);
  Twist axis(int joint, int d) const;
  Point point(const BodyFrame& frame) const;
  // Adds what the force F [N] at the point x of a body and the torque T [N m] change by.
  void add_wrench(int body, const Point& at, const Vec3& F, const Vec3& dF, const Vec3& T, const Vec3& dT, VecRef df);
  void add_springs(VecRef df);
  void add_wrenches(double t, VecRef df);
  void add_users(double t, const VecCRef& q, const VecCRef& v, const VecCRef& dq, const VecCRef& dv, VecRef df);

  const Tree* tree_;
  Placements at_;
  bool any_;
  // Twists about the world's origin, world axes: of the bodies' motion, of the direction, and the derivative of the
  // former.
  std::vector<Twist> speed_, moved_, speed_moved_;
  VecX q_, v_, dq_, dv_, force_, change_;
  MatX first_, second_;
};

}  // namespace contactvi

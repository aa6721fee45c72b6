// Derivatives of the elements' forces (forces.hpp) along a direction of configuration and velocity. Engine coordinates.
#pragma once

#include <vector>

#include "model/body_twists.hpp"

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
  Point point(const BodyFrame& frame) const;
  // Adds what the force F [N] at the point x of a body and the torque T [N m] change by.
  void add_wrench(int body, const Point& at, const Vec3& F, const Vec3& dF, const Vec3& T, const Vec3& dT, VecRef df);
  void add_springs(VecRef df);
  void add_wrenches(double t, VecRef df);
  void add_users(double t, const VecCRef& q, const VecCRef& v, const VecCRef& dq, const VecCRef& dv, VecRef df);

  const Tree* tree_;
  bool any_;
  BodyTwists bodies_;
  VecX q_, v_, dq_, dv_, force_, change_;
  MatX first_, second_;
};

}  // namespace contactvi

// Derivatives of the elements' forces (forces.hpp) along directions of configuration and velocity. Engine coordinates.
// Functions of users whose derivatives are not given count as constant, which is good enough for the matrix of a Newton
// iteration; derivatives of runs are refused before, where the scene is known (contactvi/derivatives).
#pragma once

#include <vector>

#include "model/body_twists.hpp"
#include "model/compliance.hpp"
#include "model/touching_shapes.hpp"

namespace contactvi {

class ForceTangent {
 public:
  explicit ForceTangent(const Tree& tree);

  bool any() const { return any_; }
  // Takes a time and a state, (nq,) and (nv,): functions of users are asked here, once for all directions.
  void take(double t, const VecCRef& q, const VecCRef& v);
  // df += the derivative there along (dq, dv), all of shape (nv,).
  void add(const VecCRef& dq, const VecCRef& dv, VecRef df);

 private:
  struct Point {
    Vec3 x, speed, moved, speed_moved;  // position, velocity, and their derivatives
  };
  Point point(const BodyFrame& frame) const;
  // Adds what the force F [N] at the point x of a body and the torque T [N m] change by.
  void add_wrench(int body, const Point& at, const Vec3& F, const Vec3& dF, const Vec3& T, const Vec3& dT, VecRef df);
  void add_springs(VecRef df);
  void take_compliances();
  void add_compliances(VecRef df);
  void add_wrenches(VecRef df);
  void add_users(const VecCRef& dq, const VecCRef& dv, VecRef df);

  const Tree* tree_;
  bool any_;
  BodyTwists bodies_;
  // The state that was taken, its velocity in public coordinates, too; what the user's functions are there: wrenches,
  // forces and gradients of potentials, with their derivatives.
  VecX q_, v_, public_v_;
  struct User {
    VecX force;
    MatX by_q, by_v;
  };
  std::vector<Eigen::Matrix<double, 6, 1>> wrenches_;
  // The compliant contacts that press there, by their numbers, their nearest features, and what their laws give.
  struct Pressing {
    std::size_t contact;
    NearestFeatures features;
    GivenPress given;
  };
  std::vector<Pressing> pressing_;
  std::vector<User> forces_, potentials_;
  VecX dq_, dv_, change_;
};

}  // namespace contactvi

// How the bodies move along a direction dq of the configuration, and how the generalized force of a force on a body
// changes along it. Engine coordinates.
//
// A force on a body is a wrench W about the world's origin; joint j feels S_j . W, S_j its axes in the world, which
// move with its body: dS_j = V_j x S_j, V_j the body's twist along the direction.
#pragma once

#include <vector>

#include "model/placement.hpp"

namespace contactvi {

inline Twist sum(const Twist& a, const Twist& b) { return {a.ang + b.ang, a.lin + b.lin}; }
inline Twist scaled(double k, const Twist& a) { return {k * a.ang, k * a.lin}; }

class BodyTwists {
 public:
  explicit BodyTwists(const Tree& tree);

  void place(const VecCRef& q) { contactvi::place(*tree_, q, at_); }
  const Placements& placements() const { return at_; }
  // Twist of the body about the world's origin for a unit of the joint's d-th velocity.
  Twist axis(int joint, int d) const;

  // Sets the direction, shape (nv,), at the placed configuration.
  void move(const VecCRef& dq);
  // Sets the motion v and the direction (dq, dv) there, all of shape (nv,).
  void move(const VecCRef& v, const VecCRef& dq, const VecCRef& dv);
  // Twist about the world's origin of a body (not the world) along the direction.
  const Twist& operator[](int body) const { return moved_[body]; }
  // As that of a body's motion, and its derivative along the direction; after the second form of move().
  const Twist& speed(int body) const { return speed_[body]; }
  const Twist& speed_moved(int body) const { return speed_moved_[body]; }
  // Angular velocity of a body, and velocity of its material point at x, along the direction; zero for the world (-1).
  Vec3 turn(int body) const { return body < 0 ? Vec3(Vec3::Zero()) : moved_[body].ang; }
  Vec3 velocity(int body, const Vec3& x) const {
    return body < 0 ? Vec3(Vec3::Zero()) : Vec3(moved_[body].lin + moved_[body].ang.cross(x));
  }

  // Adds what the generalized force of the force F [N] at the point x of a body and of the torque T [N m] changes by
  // along the direction, where x changes by dx, F by dF and T by dT. World frame; df: shape (nv,).
  void add_wrench(int body, const Vec3& x, const Vec3& dx, const Vec3& F, const Vec3& dF, const Vec3& T, const Vec3& dT,
                  VecRef df) const;

 private:
  const Tree* tree_;
  Placements at_;
  std::vector<Twist> moved_, speed_, speed_moved_;
};

}  // namespace contactvi

// How the velocity of surfaces that move along themselves (model/surface_motion.hpp) changes with the configuration and
// the time, along the tangents of a contact (Guards::surface_velocity) and, where it has friction against spinning and
// rolling, about its normal and its tangents (Guards::surface_turning).
#pragma once

#include "geometry/contact_tangent.hpp"

namespace contactvi {

class SurfaceVelocityTangent {
 public:
  // Takes the contact of a guard at the time t [s], which `contact` has taken, with its first tangent.
  void take(const Scene& scene, int guard, const ContactTangent& contact, const Vec3& t1, double t);
  bool moves() const { return moves_; }
  // As the rows of the contact after its normal have it (TangentFrame::rows) [m/s], two or more; and its derivatives by
  // the time and along the last direction of `contact`.
  const VecX& velocity() const { return velocity_; }
  const VecX& rate() const { return rate_; }
  VecX change(const ContactTangent& contact) const;
  // As this, with other changes of the points of a and b, of the tangents and of the normal, world.
  VecX change(const BodyTwists& twists, const Vec3 (&points)[2], const Vec3 (&tangents)[2], const Vec3& normal) const;

 private:
  struct Side {
    int body;
    double sign;         // of its velocity in that of the contact
    Vec3 x, u, turning;  // the point [m], the surface's velocity there and its angular velocity [rad/s], world
  };
  // The rows of a velocity u and an angular velocity about axes (normal, t1, t2).
  VecX along(const Vec3& u, const Vec3& turning, const Vec3& n, const Vec3& t1, const Vec3& t2) const;

  bool moves_ = false;
  Side sides_[2];
  int count_ = 0;  // of the sides that move
  Vec3 normal_, t_[2];
  Eigen::Vector2d shares_, radii_;
  VecX velocity_ = VecX::Zero(2), rate_ = VecX::Zero(2);
};

}  // namespace contactvi

// How the velocity of surfaces that move along themselves (model/surface_motion.hpp) changes with the configuration and
// the time, along the tangents of a contact (Guards::surface_velocity).
#pragma once

#include "geometry/contact_tangent.hpp"

namespace contactvi {

class SurfaceVelocityTangent {
 public:
  // Takes the contact of a guard at the time t [s], which `contact` has taken, with its first tangent.
  void take(const Scene& scene, int guard, const ContactTangent& contact, const Vec3& t1, double t);
  bool moves() const { return moves_; }
  // As the rows of the contact have it (TangentFrame::rows) [m/s], and its derivatives by the time and along the last
  // direction of `contact`.
  const Eigen::Vector2d& velocity() const { return velocity_; }
  const Eigen::Vector2d& rate() const { return rate_; }
  Eigen::Vector2d change(const ContactTangent& contact) const;

 private:
  struct Side {
    int body;
    double sign;         // of its velocity in that of the contact
    Vec3 x, u, turning;  // the point [m], the surface's velocity there and its angular velocity [rad/s], world
  };

  bool moves_ = false;
  Side sides_[2];
  int count_ = 0;  // of the sides that move
  Vec3 t_[2];
  Eigen::Vector2d shares_;
  Eigen::Vector2d velocity_ = Eigen::Vector2d::Zero(), rate_ = Eigen::Vector2d::Zero();
};

}  // namespace contactvi

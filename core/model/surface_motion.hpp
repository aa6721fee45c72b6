// Surfaces that move along themselves while their bodies stay: belts, treadmills, turntables.
#pragma once

#include "base/numerics.hpp"
#include "model/contact_law.hpp"

namespace contactvi {

struct SurfaceMotion {
  // Velocity field of the surface beside that of its body, in the frame of the geometry: linear + angular x r [m/s],
  // r from the geometry's origin. What of it is along a contact's normal does not count.
  Vec3 linear, angular;
  NumberFunction profile;  // of the time, by which the field is multiplied; not given: 1

  Vec3 velocity(const Vec3& r, double t) const {
    const Vec3 field = linear + angular.cross(r);
    return profile.given() ? Vec3(profile(t) * field) : field;
  }
  // Its angular velocity [rad/s].
  Vec3 turning(double t) const { return profile.given() ? Vec3(profile(t) * angular) : angular; }
};

}  // namespace contactvi

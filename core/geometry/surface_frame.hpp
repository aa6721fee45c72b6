// The frame of a surface that a function gives, fixed to a body.
#pragma once

#include "geometry/candidates.hpp"
#include "model/scene.hpp"

namespace contactvi {

// In the world.
inline Pose pose_of_surface(const Geometry& g, const Placements& at) {
  const Pose body = pose_of(g.body, at);
  return {body.R * g.R_BG, body.point(g.p_BG)};
}
// From the frame of the body of a surface into its own, and back.
inline Vec3 in_surface(const Geometry& g, const Vec3& x_B) { return g.R_BG.transpose() * (x_B - g.p_BG); }
inline Vec3 in_body(const Geometry& g, const Vec3& x) { return g.p_BG + g.R_BG * x; }

}  // namespace contactvi

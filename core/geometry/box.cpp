#include "geometry/box.hpp"

namespace contactvi {

Box box_of(const Geometry& g, const Placements& at) {
  const bool fixed = g.body < 0;
  const Mat3 R = fixed ? g.R_BG : Mat3(at.R_W[g.body] * g.R_BG);
  const Vec3 p = fixed ? g.p_BG : Vec3(at.p_W[g.body] + at.R_W[g.body] * g.p_BG);
  return {p + R * g.box_center, g.is_ball ? g.box_half : Vec3(R.cwiseAbs() * g.box_half)};
}

double separation(const Box& box, const Geometry& h, const Placements& at) {
  const bool fixed = h.body < 0;
  const Vec3 n = fixed ? Vec3(h.R_BG * h.halfspace_normal) : Vec3(at.R_W[h.body] * (h.R_BG * h.halfspace_normal));
  const Vec3 p = fixed ? h.p_BG : Vec3(at.p_W[h.body] + at.R_W[h.body] * h.p_BG);
  return n.dot(box.center - p) - n.cwiseAbs().dot(box.half) - h.halfspace_offset;
}

}  // namespace contactvi

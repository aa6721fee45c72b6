#include "geometry/surface_velocity_tangent.hpp"

namespace contactvi {

void SurfaceVelocityTangent::take(const Scene& scene, int guard, const ContactTangent& contact, const Vec3& t1,
                                  double t) {
  moves_ = scene.is_pair(guard) && scene.pairs[guard].moves;
  count_ = 0;
  shares_ = contact.shares();
  radii_ = contact.turning();
  const Contact& at = contact.contact();
  normal_ = at.normal;
  t_[0] = t1;
  t_[1] = at.normal.cross(t1);
  Vec3 sum = Vec3::Zero(), rate = sum, turning = sum, turning_rate = sum;
  for (const bool b : {false, true}) {
    if (!moves_) break;
    const Geometry& g = scene.geometries[b ? scene.pairs[guard].b : scene.pairs[guard].a];
    if (g.motion < 0) continue;
    const Pose body = pose_of(g.body, contact.twists().placements());
    const Mat3 R = body.R * g.R_BG;
    const Vec3 x = b ? at.point_b : at.point_a;
    const SurfaceMotion& motion = scene.surface_motions[g.motion];
    const Vec3 field = R * (motion.linear + motion.angular.cross(R.transpose() * (x - body.point(g.p_BG))));
    const double share = motion.profile.given() ? motion.profile(t) : 1.0, sign = b ? 1.0 : -1.0;
    sides_[count_++] = {g.body, sign, x, share * field, R * motion.turning(t)};
    sum += sign * share * field;
    turning += sign * sides_[count_ - 1].turning;
    if (!motion.profile.given()) continue;
    rate += sign * motion.profile.slope(t) * field;
    turning_rate += sign * motion.profile.slope(t) * (R * motion.angular);
  }
  velocity_ = along(sum, turning, normal_, t_[0], t_[1]);
  rate_ = along(rate, turning_rate, normal_, t_[0], t_[1]);
}

VecX SurfaceVelocityTangent::along(const Vec3& u, const Vec3& turning, const Vec3& n, const Vec3& t1,
                                   const Vec3& t2) const {
  const bool spins = radii_[0] > 0.0, rolls = radii_[1] > 0.0;
  VecX found(2 + (spins ? 1 : 0) + (rolls ? 2 : 0));
  found.head<2>() << shares_[0] * t1.dot(u), shares_[1] * t2.dot(u);
  if (spins) found[2] = radii_[0] * n.dot(turning);
  if (rolls) found.tail<2>() << radii_[1] * t1.dot(turning), radii_[1] * t2.dot(turning);
  return found;
}

VecX SurfaceVelocityTangent::change(const ContactTangent& contact) const {
  return change(contact.twists(), {contact.point_a_change(), contact.point_b_change()},
                {contact.tangent_change(0), contact.tangent_change(1)}, contact.normal_change());
}

VecX SurfaceVelocityTangent::change(const BodyTwists& twists, const Vec3 (&points)[2], const Vec3 (&tangents)[2],
                                    const Vec3& normal) const {
  VecX found = VecX::Zero(velocity_.size());
  for (int k = 0; k < count_; ++k) {
    const Side& s = sides_[k];
    const Vec3 &dx = points[s.sign > 0.0 ? 1 : 0], turned = twists.turn(s.body);
    const Vec3 du = turned.cross(s.u) + s.turning.cross(dx - twists.velocity(s.body, s.x));
    found += s.sign * (along(du, turned.cross(s.turning), normal_, t_[0], t_[1]) +
                       along(s.u, s.turning, normal, tangents[0], tangents[1]));
  }
  return found;
}

}  // namespace contactvi

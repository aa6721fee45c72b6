#include "geometry/surface_velocity_tangent.hpp"

namespace contactvi {

void SurfaceVelocityTangent::take(const Scene& scene, int guard, const ContactTangent& contact, const Vec3& t1,
                                  double t) {
  moves_ = scene.is_pair(guard) && scene.pairs[guard].moves;
  count_ = 0;
  velocity_.setZero();
  rate_.setZero();
  if (!moves_) return;
  const Contact& at = contact.contact();
  t_[0] = t1;
  t_[1] = at.normal.cross(t1);
  Vec3 sum = Vec3::Zero(), rate = sum;
  for (const bool b : {false, true}) {
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
    if (motion.profile.given()) rate += sign * motion.profile.slope(t) * field;
  }
  shares_ = contact.shares();
  velocity_ << shares_[0] * t_[0].dot(sum), shares_[1] * t_[1].dot(sum);
  rate_ << shares_[0] * t_[0].dot(rate), shares_[1] * t_[1].dot(rate);
}

Eigen::Vector2d SurfaceVelocityTangent::change(const ContactTangent& contact) const {
  Eigen::Vector2d found = Eigen::Vector2d::Zero();
  const BodyTwists& twists = contact.twists();
  for (int k = 0; k < count_; ++k) {
    const Side& s = sides_[k];
    const Vec3 dx = s.sign > 0.0 ? contact.point_b_change() : contact.point_a_change();
    const Vec3 du = twists.turn(s.body).cross(s.u) + s.turning.cross(dx - twists.velocity(s.body, s.x));
    for (int i = 0; i < 2; ++i) found[i] += s.sign * shares_[i] * (t_[i].dot(du) + contact.tangent_change(i).dot(s.u));
  }
  return found;
}

}  // namespace contactvi

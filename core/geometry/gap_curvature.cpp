#include "geometry/gap_curvature.hpp"

namespace contactvi {

GapCurvature::GapCurvature(const Scene& scene)
    : scene_(&scene), bodies_(scene.tree), none_(DualX::Zero(scene.tree.nv)), unused_(scene.tree.nv) {}

bool GapCurvature::take(const VecCRef& q, int guard, const ContactTangent& contact, const VecCRef& W) {
  q_ = q;
  is_limit_ = !scene_->is_pair(guard);
  fixed_ = W;
  if (is_limit_) return true;
  Placements at(scene_->tree);
  place(scene_->tree, q, at);
  const Contact& touch = contact.contact();
  const auto in_body = [&](int side) {
    const int body = side == 0 ? touch.body_a : touch.body_b;
    const Vec3& x = contact.surface(side).x();
    return Side{body, body < 0 ? x : Vec3(at.R_W[body].transpose() * (x - at.p_W[body]))};
  };
  const bool point[2] = {contact.surface(0).is_point(), contact.surface(1).is_point()};
  const int face = contact.surface(0).is_plane() ? 0 : 1;
  has_face_ = contact.surface(face).is_plane();
  if (!(point[0] && point[1]) && !(has_face_ && point[1 - face])) {
    why_ = std::string(contact.surface(0).name()) + " against " + contact.surface(1).name();
    return false;
  }
  first_ = in_body(has_face_ ? face : 0);
  second_ = in_body(has_face_ ? 1 - face : 1);
  const Vec3 outward = face == 0 ? touch.normal : Vec3(-touch.normal);
  normal_B_ = first_.body < 0 ? outward : Vec3(at.R_W[first_.body].transpose() * outward);
  return true;
}

void GapCurvature::along(const VecCRef& dq, const DualX& y, DualX& W, DualX& of_q) {
  of_q = none_;
  W = none_;
  if (is_limit_) {
    W = fixed_.cast<DualNumber>();
    return;
  }
  bodies_.take(q_, dq, none_, y);
  if (has_face_) {
    from_face(W, of_q);
  } else {
    between_points(W, of_q);
  }
}

// The gap is |b - a| less radii; W . y = n . (u_b - u_a) for the velocities u of the points under the motion y.
void GapCurvature::between_points(DualX& W, DualX& of_q) {
  const MovingPoint a = bodies_.point(first_.body, first_.p_B), b = bodies_.point(second_.body, second_.p_B);
  const Dual3 apart = b.x - a.x, speed = b.u - a.u;
  const DualNumber distance = sqrt(apart.dot(apart));
  const Dual3 n = apart / distance, of_x = (speed - n * n.dot(speed)) / distance;
  bodies_.add_row(second_.body, b.x, n, W);
  bodies_.add_row(first_.body, a.x, -n, W);
  bodies_.add_point(second_.body, b, {of_x, Dual3::Zero(), n}, of_q, unused_);
  bodies_.add_point(first_.body, a, {-of_x, Dual3::Zero(), -n}, of_q, unused_);
}

// The gap is m . (b - a) less radii, m the normal of a face and a a point of it, which turn with their body at w:
// W . y = m . (u_b - u_a) + (w x m) . (b - a).
void GapCurvature::from_face(DualX& W, DualX& of_q) {
  const MovingPoint a = bodies_.point(first_.body, first_.p_B), b = bodies_.point(second_.body, second_.p_B);
  const Dual3 m = bodies_.axes({first_.body}) * normal_B_.cast<DualNumber>(), apart = b.x - a.x;
  bodies_.add_row(second_.body, b.x, m, W);
  bodies_.add_row(first_.body, b.x, -m, W);
  const Dual3 spin = first_.body < 0 ? Dual3(Dual3::Zero()) : bodies_.of_u(first_.body).ang;
  const Dual3 of_x = spin.cross(m), of_m = b.u - a.u + apart.cross(spin);
  bodies_.add_point(second_.body, b, {of_x, Dual3::Zero(), m}, of_q, unused_);
  bodies_.add_point(first_.body, a, {-of_x, Dual3::Zero(), -m}, of_q, unused_);
  bodies_.add_turn(first_.body, m.cross(apart), m.cross(of_m), of_q);
}

}  // namespace contactvi

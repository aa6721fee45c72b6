#include "contact/persistent_geometry.hpp"

namespace contactvi {

void PersistentGeometry::evaluate(const ContactPoint& point, Contact& contact) const {
  if (point.kind == PointKind::kWitness || point.kind == PointKind::kLimit) {
    guards_->evaluate_witness(point.guard, contact);
  } else {
    guards_->manifolds().evaluate(point, guards_->placements(point.guard), contact);
  }
}

// That of a point on a plane turns with the plane's body.
Vec3 PersistentGeometry::vertex_tangent(const PersistentContact& persistent) const {
  const int body = persistent.point.plane_body;
  return body < 0 ? persistent.tangent
                  : Vec3(guards_->placements(persistent.point.guard).R_W[body] * persistent.tangent);
}

Vec3 PersistentGeometry::start_tangent(const PersistentContact& persistent, const Contact& contact) const {
  if (persistent.mu == 0.0) return Vec3::Zero();
  if (guards_->has_axis(persistent.point.guard)) return guards_->tangent(persistent.point.guard, contact.normal);
  if (persistent.point.kind == PointKind::kVertex) return vertex_tangent(persistent);
  return carried_tangent(persistent.tangent, contact.normal, contact.normal);
}

Vec3 PersistentGeometry::tangent(const PersistentContact& persistent, const Contact& contact, const Contact& before,
                                 const Vec3& t1) const {
  if (persistent.mu == 0.0) return Vec3::Zero();
  if (guards_->has_axis(persistent.point.guard)) return guards_->tangent(persistent.point.guard, contact.normal);
  if (persistent.point.kind == PointKind::kVertex) return vertex_tangent(persistent);
  return carried_tangent(t1, before.normal, contact.normal);
}

Vec3 PersistentGeometry::position_on_plane(const ContactPoint& point) const {
  const Placements& at = guards_->placements(point.guard);
  const Vec3 c = point.point_body < 0 ? point.center_B
                                      : Vec3(at.p_W[point.point_body] + at.R_W[point.point_body] * point.center_B);
  if (point.plane_body < 0) return c;
  return at.R_W[point.plane_body].transpose() * (c - at.p_W[point.plane_body]);
}

Vec3 PersistentGeometry::reference(const PersistentContact& persistent) const {
  return persistent.anchored ? persistent.anchor : position_on_plane(persistent.point);
}

Eigen::Vector2d PersistentGeometry::displacement(const PersistentContact& persistent, const Vec3& reference) const {
  const Vec3 moved = position_on_plane(persistent.point) - reference;
  // A point of b moves on a plane of a; for a point of a on a plane of b the relative motion is the opposite.
  const double sign = persistent.point.on_b ? 1.0 : -1.0;
  const Vec3 t1 = persistent.tangent, t2 = sign * persistent.point.normal_B.cross(t1);
  return sign * Eigen::Vector2d(moved.dot(t1), moved.dot(t2));
}

}  // namespace contactvi

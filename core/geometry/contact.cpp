#include "geometry/contact.hpp"

#include "model/point_jacobian.hpp"

namespace contactvi {

void gap_gradient(const Tree& tree, const Placements& at, const Contact& contact, VecRef W) {
  W.setZero();
  add_point_row(tree, at, contact.body_b, contact.point_b, contact.normal, 1.0, W);
  add_point_row(tree, at, contact.body_a, contact.point_a, contact.normal, -1.0, W);
}

void contact_rows(const Tree& tree, const Placements& at, const Contact& contact, const Vec3& t1, Eigen::Ref<MatX> W) {
  W.setZero();
  const Vec3 directions[3] = {contact.normal, t1, contact.normal.cross(t1)};
  add_point_rows(tree, at, contact.body_b, contact.point_b, directions, 1.0, W);
  add_point_rows(tree, at, contact.body_a, contact.point_a, directions, -1.0, W);
}

void turning_rows(const Tree& tree, const Placements& at, const Contact& contact, const Vec3& t1, double spinning,
                  double rolling, Eigen::Ref<MatX> W) {
  W.setZero();
  Eigen::Index k = 0;
  const auto add = [&](const Vec3& axis, double radius) {
    add_turn_row(tree, at, contact.body_b, axis, radius, W.col(k));
    add_turn_row(tree, at, contact.body_a, axis, -radius, W.col(k));
    ++k;
  };
  if (spinning > 0.0) add(contact.normal, spinning);
  if (rolling > 0.0) {
    add(t1, rolling);
    add(contact.normal.cross(t1), rolling);
  }
}

Vec3 carried_tangent(const Vec3& t, const Vec3& n0, const Vec3& n1) {
  const double c = 1.0 + n0.dot(n1);
  if (c < 1e-6) return any_tangent(n1);  // turned right round: no shortest turn
  const Vec3 turned = t - (t.dot(n1) / c) * (n0 + n1);
  return (turned - turned.dot(n1) * n1).normalized();
}

}  // namespace contactvi

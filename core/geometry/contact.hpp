// A point where two bodies may touch, and the gradient of its gap.
#pragma once

#include "model/placement.hpp"

namespace contactvi {

// [m] by which the features of a face that is flat to rounding differ.
constexpr double kFeatureRounding = 1e-10;

// World frame. normal points from body a to body b; gap = (point_b - point_a).normal, negative in penetration.
struct Contact {
  double gap;
  Vec3 normal;
  Vec3 point_a, point_b;
  int body_a, body_b;  // engine joints, -1: world
};

// The tangents t1, t2 = n x t1 of a contact whose rows are the velocities along them times these shares, which tell how
// much of the coefficient of friction acts along each: Coulomb's circular cone in the rows is then an elliptic one.
struct TangentFrame {
  Vec3 t1, t2;
  Eigen::Vector2d shares = Eigen::Vector2d::Ones();
  // Slip and force in the world that rows have, and the rows of a slip.
  Vec3 slip(const Eigen::Vector2d& w) const { return w[0] / shares[0] * t1 + w[1] / shares[1] * t2; }
  Vec3 force(const Eigen::Vector2d& f) const { return f[0] * shares[0] * t1 + f[1] * shares[1] * t2; }
  Eigen::Vector2d rows(const Vec3& slip) const { return {shares[0] * t1.dot(slip), shares[1] * t2.dot(slip)}; }
  // The impulses along the rows of a force in the world.
  Eigen::Vector2d impulses(const Vec3& force) const { return {t1.dot(force) / shares[0], t2.dot(force) / shares[1]}; }
};

// W = d(gap)/dq = n^T (J_B(x_B) - J_A(x_A)) in engine coordinates, shape (nv,). at: the placements at the same q.
void gap_gradient(const Tree& tree, const Placements& at, const Contact& contact, VecRef W);

// Rows n, t1, t2 of the relative velocity of the contact's two points, b less a, as the columns of W (nv, 1 or 3);
// t1: unit tangent, world frame; t2 = n x t1.
void contact_rows(const Tree& tree, const Placements& at, const Contact& contact, const Vec3& t1, Eigen::Ref<MatX> W);

// Rows of the relative angular velocity of the two bodies, b less a, as the columns of W (nv, 1 to 3), as speeds [m/s]:
// about the normal times the radius `spinning`, if it is > 0, then about t1 and t2 times the radius `rolling`, if so.
void turning_rows(const Tree& tree, const Placements& at, const Contact& contact, const Vec3& t1, double spinning,
                  double rolling, Eigen::Ref<MatX> W);

// The tangent t turned with its normal from n0 to n1 (the shortest turn), so that a basis does not flip between steps.
Vec3 carried_tangent(const Vec3& t, const Vec3& n0, const Vec3& n1);

}  // namespace contactvi

// The laws of block_problem.hpp for one contact by itself. Impulses and velocities of a contact are (n, t1, t2); one
// with a single row has zeros behind it.
//
// With De Saxce's correction (De Saxce, Feng, "The bipotential method", 1998) the law of contact and friction is one
// variational inequality, also with a lower bound of the normal impulse:
//
//   lambda in S,  -(w_n + mu |w_t|, w_t) in the normal cone of S at lambda
//   S: lambda_n >= lower, |lambda_t| <= mu lambda_n
//
// so that lambda = P_S(lambda - r (w_n + mu |w_t|, w_t)) for any r > 0, P_S the projection onto S.
#pragma once

#include <Eigen/Core>

#include "cone/block_problem.hpp"

namespace contactvi {

using Vec2 = Eigen::Vector2d;
using Mat2 = Eigen::Matrix2d;

// A contact's own matrix G = W^T M^-1 W, and what its exact solution needs of it.
struct ContactMatrix {
  Mat3 G = Mat3::Zero();          // with a shift that keeps singular contacts (few joints) solvable
  double largest = 0.0;           // of the diagonal [1/kg]: the scale between impulse and velocity of this contact
  Vec2 coupling = Vec2::Zero();   // G_tn / G_nn
  Mat2 axes = Mat2::Identity();   // principal axes of S = G_tt - G_tn G_nt / G_nn
  Vec2 stiffness = Vec2::Zero();  // eigenvalues of S
  // From G. floor: least diagonal that counts [1/kg]; single: one row, which has no axes.
  void finish(double floor, bool single);
};

// Impulses per contact and the velocity that belongs to them: of the blocks (block_system.hpp) or of the rows
// (dense_system.hpp).
struct ConePoint {
  std::vector<Vec3> lambda;  // (contacts,) [N s]
  VecX v;
  double residual = 0.0;  // of the law, over the scale of speeds
};

// Shift of a contact's own matrix, a share of its largest diagonal. The sweeps subtract the same matrix from w, so that
// their fixed points are those of the unshifted law; a direction that joints leave immobile changes by rounding over
// the shift, 1e-6 of the impulses, and moves nothing.
constexpr double kOwnShift = 1e-10;

inline bool is_box(const BlockContact& c) { return c.box > 0.0; }
inline bool has_friction(const BlockContact& c) { return c.rows == 3 && c.mu > 0.0; }
inline bool has_gap(const BlockContact& c) { return c.of < 0 && !is_box(c); }
// Not a point with turning friction nor that friction, whose law is that of turning_law.hpp.
inline bool is_alone(const BlockContact& c) { return c.of < 0 && c.turning < 0; }

// Projection onto the impulses that the law allows.
Vec3 project_impulse(const BlockContact& c, const Vec3& x);

// Error of the law as a velocity: g (lambda - P(lambda - (w + mu |w_t| n)/g)), largest row [m/s].
double law_error(const BlockContact& c, double g, const Vec3& lambda, const Vec3& w);

// The impulse that fulfils the law with w = b + G lambda. previous: the last impulse, a start for the slip.
Vec3 solve_contact(const BlockContact& c, const ContactMatrix& m, const Vec3& b, const Vec3& previous);

// Linearisation of the natural map at (lambda, w), in coordinates (mu lambda_n, lambda_t) and (w_n/mu + |w_t|, w_t) in
// which the friction cone is its own dual, with 1 - D shifted by the share `shift` (D: derivative of the projection):
//   d lambda = start - K d w
struct LawTangent {
  Mat3 K;
  Vec3 start;
};
LawTangent law_tangent(const BlockContact& c, double g, const Vec3& lambda, const Vec3& w, double shift);

// Square of the natural map in these coordinates, times g^2 [m^2/s^2]: the merit that belongs to the linearisation.
double law_merit(const BlockContact& c, double g, const Vec3& lambda, const Vec3& w);

}  // namespace contactvi

// The Coulomb cone problem: contacts with a normal and, where there is friction, two tangential rows or more.
//
//   w = b + G lambda                                     velocities and impulses, per contact rows (n) or
//                                                        (n, t1, t2[, spin][, roll1, roll2])
//   normal      lambda_n >= lower, w_n >= 0, (lambda_n - lower) w_n = 0
//   tangential  |lambda_t| <= mu lambda_n; w_t != 0 => lambda_t = -mu lambda_n w_t/|w_t|   (maximal dissipation)
//   frozen      lambda_t = -mu lambda_n d with a given unit vector d, whatever w_t
//   spinning    lambda_t and w_t have a third component, the spin, in one ball (Leine, Glocker, "A set-valued force law
//               for spatial Coulomb-Contensou friction", 2003)
//   rolling     the same law as the tangential one between lambda_r and w_r, with a coefficient of its own
// Among them may be rows of joint friction with a given bound (`box`).
#pragma once

#include <Eigen/Core>
#include <limits>
#include <vector>

#include "base/numerics.hpp"
#include "base/tolerances.hpp"

namespace contactvi {

struct ConeContact {
  int row = 0;   // first row
  int rows = 3;  // 3, or 1: frictionless contact, joint limit; more with spinning and rolling friction
  double mu = 0.0;
  double lower = 0.0;  // >= 0; Poisson's expansion asks for e times the impulse of the compression
  bool frozen = false;
  Eigen::Vector2d d = Eigen::Vector2d::Zero();
  bool spins = false;    // friction has a row of spinning
  double d_spin = 0.0;   // third component of d
  double rolling = 0.0;  // > 0: two rows of rolling, whose friction is at most rolling * lambda_n
  bool frozen_rolling = false;
  Eigen::Vector2d d_rolling = Eigen::Vector2d::Zero();
  // > 0: friction of a joint, one row. |lambda| <= box; w != 0 => lambda = -box sign(w); frozen: lambda = -box d_0.
  double box = 0.0;

  int friction_rows() const { return spins ? 3 : 2; }
  int rolling_row() const { return 1 + friction_rows(); }  // of the contact's
  // What friction of all kinds needs in rows.
  int rows_of_friction() const { return 1 + friction_rows() + (rolling > 0.0 ? 2 : 0); }
};

// The contacts cover all rows, in order and without gaps. G (m, m) may be nonsymmetric (a step's G is, by O(h)).
struct ConeProblem {
  const std::vector<ConeContact>& contacts;
  Eigen::Ref<const MatX> G;
  Eigen::Ref<const VecX> b;
  // Error of b [m/s]: the gaps of a face's four corners are not quite those of a plane, by rounding, and gap/h stands
  // in b. Errors of w up to it are no errors.
  double noise = 0.0;
  // Share of the terms by which the rows of a contact may disagree, where its matrix is singular and it is alone.
  double rough = 0.0;
  // Residual that is good enough: where Newton's method ends below it no other starts are tried.
  double accept = kConeTolerance;
  // Degrees of freedom that the rows act on: the rank of G is no larger.
  int freedoms = std::numeric_limits<int>::max();
};

struct ConeResult {
  bool ok = false;        // residual <= kConeTolerance
  double residual = 0.0;  // natural map, relative (natural_map.hpp); infinity for data that is not finite
  int iterations = 0;     // Newton steps, of all starts
  int factors = 0;        // of them those with a new factor of the matrix
  int fallbacks = 0;      // starts from the interior point method or from sweeps
};

}  // namespace contactvi

// The law of a point with friction against spinning and rolling (block_problem.hpp), in six rows: (n, t1, t2) of the
// point, then (spin, roll1, roll2) of its turning. Rows that are zero have no impulse and change nothing.
//
// Its natural map (Alart and Curnier, "A mixed formulation for frictional contact problems prone to Newton like
// solution methods", 1991) has a projection for each kind of friction, since the cone, an intersection of two, is no
// cone of second order:
//
//   F_n = lambda_n - rho,  rho = max(lower, lambda_n - w_n/g_n)
//   F_t = lambda_t - P(lambda_t - w_t/g_t),  P: onto the ball of radius mu rho, lambda_t with the spin
//   F_r = lambda_r - P(lambda_r - w_r/g_r),  P: onto the disc of radius rho
#pragma once

#include <Eigen/Core>

#include "cone/block_problem.hpp"

namespace contactvi {

using Vec6 = Eigen::Matrix<double, 6, 1>;
using Mat6 = Eigen::Matrix<double, 6, 6>;

// The own matrix of the six rows, and the scales between impulse and velocity of the map [1/kg].
struct TurningMatrix {
  Mat6 G = Mat6::Zero();
  double normal = 0.0, slip = 0.0, rolling = 0.0;
  // From G. floor: least diagonal that counts [1/kg].
  void finish(double floor);
};

// The least normal impulse that allows these impulses of friction.
double least_normal(double mu, const Vec3& point, const Vec3& turning);

// Impulses that the law allows: the normal one at its bound, friction cut to what it allows.
Vec6 project_turning(const BlockContact& c, const Vec6& lambda);

// The natural map as a velocity, g F [m/s].
Vec6 turning_map(const BlockContact& c, const TurningMatrix& m, const Vec6& lambda, const Vec6& w);

// Sum of the squares of its parts, each over its scale, times that of the normal [m^2/s^2]: small radii count as much.
double turning_merit(const TurningMatrix& m, const Vec6& map);

// Its linearisation at (lambda, w), d lambda = start - K d w, with 1 - D shifted as in block_law.hpp.
struct TurningTangent {
  Mat6 K;
  Vec6 start;
};
TurningTangent turning_tangent(const BlockContact& c, const TurningMatrix& m, const Vec6& lambda, const Vec6& w,
                               double shift);

// The impulse that fulfils the law with w = b + G lambda, by Newton's method from `previous`; where that stalls, a
// projected step towards it.
Vec6 solve_turning_contact(const BlockContact& c, const TurningMatrix& m, const Vec6& b, const Vec6& previous);

}  // namespace contactvi

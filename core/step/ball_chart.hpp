// Derivatives of the chart exp of SO(3) at X, in which the step equations of spherical joints stand, as matrices.
//
// With the rate u = X', the velocity is v = J u, J = J_r(X); with the momentum P and the force G of the body,
//   P_x = J^T P,   G_x = J^T G + E^T P,   E = d(J u)/dX
// are the derivatives of the Lagrangian by u and X. G_x is the rate of the chart momentum in lanes/lane_iteration.hpp.
#pragma once

#include "base/numerics.hpp"

namespace contactvi {

struct BallChart {
  // At X, with the velocity v, momentum P and force G there.
  BallChart(const Vec3& X, const Vec3& v, const Vec3& P, const Vec3& G);

  Vec3 u, P_x, G_x;
  Mat3 R;  // exp(X)
  Mat3 J, E;
  Mat3 H;  // d(J^T P)/dX at fixed P
  Mat3 N;  // dG_x/dX at fixed u, P and G
};

Mat3 so3_right_jacobian(const Vec3& X);
// d(J_r(X) y)/dX.
Mat3 so3_right_jacobian_change(const Vec3& X, const Vec3& y);

}  // namespace contactvi

// Small vectors and the calculus of SO(3).
//
// Pinocchio's Jexp6/Jlog6 lose digits for small rotations (8e-10 at 3e-4 rad), and momentum then drifts; the functions
// here use power series below |xi| = 0.3 and keep full precision at every angle up to pi.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <limits>

namespace contactvi {

using Vec3 = Eigen::Vector3d;
using Mat3 = Eigen::Matrix3d;
using VecX = Eigen::VectorXd;
using MatX = Eigen::MatrixXd;
using Quat = Eigen::Quaterniond;
using VecRef = Eigen::Ref<VecX>;
using VecCRef = Eigen::Ref<const VecX>;

constexpr double kTwoPi = 6.283185307179586476925;
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// Spatial force or momentum: moment about the frame's origin and force, both in that frame.
struct Wrench {
  Vec3 ang;
  Vec3 lin;
};

// Spatial velocity: angular velocity and velocity of the frame's origin, both in that frame.
struct Twist {
  Vec3 ang;
  Vec3 lin;
};

// Motion cross product a x b, and the power of a wrench on a twist.
inline Twist cross(const Twist& a, const Twist& b) {
  return {a.ang.cross(b.ang), a.ang.cross(b.lin) + a.lin.cross(b.ang)};
}
inline double dot(const Wrench& f, const Twist& v) { return f.ang.dot(v.ang) + f.lin.dot(v.lin); }

// Coefficients of the functions of xi used in one midpoint step, theta = |xi|:
//   exp(xi)      x = x + sin_t xi*x + cos_t xi*(xi*x)          sin_t = sin(theta)/theta, cos_t = (1-cos theta)/theta^2
//   Jl(xi)       x = x + cos_t xi*x + cub_t xi*(xi*x)          cub_t = (theta - sin theta)/theta^3
//   Jl(xi)^-1    x = x - 1/2   xi*x + inv_t xi*(xi*x)          inv_t = (1 - theta/2 cot(theta/2))/theta^2
// (xi*x is the cross product; Jr(xi) = Jl(-xi) = Jl(xi)^T.)
struct So3Coefficients {
  double sin_t, cos_t, cub_t, inv_t;
};
So3Coefficients so3_coefficients(double theta_squared);

// x + a xi*x + b xi*(xi*x).
inline Vec3 so3_apply(const Vec3& xi, double a, double b, const Vec3& x) {
  const Vec3 c = xi.cross(x);
  return x + a * c + b * xi.cross(c);
}

// Inverse of the right Jacobian Jr(xi), exp(xi + d) = exp(xi) exp(Jr d) to first order in d.
Mat3 so3_right_jacobian_inverse(const Vec3& xi);

Mat3 skew(const Vec3& x);

// Unit quaternion of the rotation vector xi.
Quat so3_exp(const Vec3& xi);
// Rotation vector of a unit quaternion, |xi| <= pi.
Vec3 so3_log(const Quat& quat);

// Some unit vector orthogonal to n.
Vec3 any_tangent(const Vec3& n);

}  // namespace contactvi

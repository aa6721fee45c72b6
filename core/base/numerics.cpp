#include "base/numerics.hpp"

#include <cmath>

namespace contactvi {

namespace {
constexpr double kSeriesBound = 0.09;  // [rad^2] theta^2 below which the series are used: theta = 0.3
}

So3Coefficients so3_coefficients(double x) {
  So3Coefficients c;
  if (x < kSeriesBound) {
    // The truncation is below 1e-17 at x = 0.09: the next terms are x^7/15! and smaller.
    c.sin_t = 1 + x * (-1. / 6 +
                       x * (1. / 120 + x * (-1. / 5040 + x * (1. / 362880 + x * (-1. / 39916800 + x / 6227020800.)))));
    c.cos_t = 0.5 + x * (-1. / 24 + x * (1. / 720 + x * (-1. / 40320 + x * (1. / 3628800 + x * (-1. / 479001600)))));
    c.cub_t = 1. / 6 + x * (-1. / 120 + x * (1. / 5040 + x * (-1. / 362880 + x * (1. / 39916800 - x / 6227020800.))));
    // 1 - t/2 cot(t/2) = sum |B_2n| t^2n / (2n)!
    c.inv_t = 1. / 12 +
              x * (1. / 720 +
                   x * (1. / 30240 +
                        x * (1. / 1209600 +
                             x * (1. / 47900160 + x * (691. / 1307674368000. +
                                                       x * (1. / 74724249600. + x * 3617. / 10670622842880000.))))));
    return c;
  }
  const double theta = std::sqrt(x), s = std::sin(theta), half = std::sin(0.5 * theta);
  c.sin_t = s / theta;
  c.cos_t = 2 * half * half / x;
  c.cub_t = (1 - c.sin_t) / x;
  c.inv_t = (1 - 0.5 * theta * std::cos(0.5 * theta) / half) / x;
  return c;
}

Mat3 skew(const Vec3& x) {
  Mat3 s;
  s << 0, -x.z(), x.y(), x.z(), 0, -x.x(), -x.y(), x.x(), 0;
  return s;
}

Mat3 so3_right_jacobian_inverse(const Vec3& xi) {
  const So3Coefficients c = so3_coefficients(xi.squaredNorm());
  const Mat3 s = skew(xi);
  return Mat3::Identity() + 0.5 * s + c.inv_t * s * s;
}

Quat so3_exp(const Vec3& xi) {
  const double x = 0.25 * xi.squaredNorm();  // (theta/2)^2
  const So3Coefficients c = so3_coefficients(x);
  const Vec3 im = 0.5 * c.sin_t * xi;
  return Quat(1 - x * c.cos_t, im.x(), im.y(), im.z());
}

Vec3 so3_log(const Quat& quat) {
  const double sign = quat.w() < 0 ? -1.0 : 1.0;
  const Vec3 im = sign * quat.vec();
  const double n = im.norm(), w = sign * quat.w();
  // atan2 is accurate for small and for large angles; for tiny n the ratio theta/sin(theta/2) tends to 2/w.
  const double scale = n < 1e-8 ? 2.0 / w : 2.0 * std::atan2(n, w) / n;
  return scale * im;
}

Vec3 any_tangent(const Vec3& n) {
  Eigen::Index smallest;
  n.cwiseAbs().minCoeff(&smallest);
  const Vec3 axis = Vec3::Unit(smallest);
  return (axis - n.dot(axis) * n).normalized();
}

}  // namespace contactvi

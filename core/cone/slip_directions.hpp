// Directions u of slip in which a force along u keeps u: k - Q u is parallel to u.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>

namespace contactvi {

// f(u) = v.(k - Q u) with v = u turned by 90 degrees is zero there. With u = (cos a, sin a) it is a trigonometric
// polynomial of degree 2 (a quartic in tan(a/2)): at most four roots.
struct SlipDirections {
  using Vec2 = Eigen::Vector2d;
  Vec2 k;
  Eigen::Matrix2d Q;

  double value(const Vec2& u) const {
    const Vec2 f = k - Q * u;
    return u[0] * f[1] - u[1] * f[0];
  }
  double slope(const Vec2& u) const {
    const Vec2 v(-u[1], u[0]), f = k - Q * u, df = Q * v;
    return -u.dot(f) - v.dot(df);
  }
  // Hands the roots to found(u), in a fixed order, until that is true: Newton's method kept inside brackets of an even
  // sampling. Two roots between neighbouring samples are a nearly double root.
  template <class Found>
  bool roots(Found found) const {
    const Samples& circle = samples();
    double last = value(circle[0]);
    for (std::size_t i = 1; i < circle.size(); ++i) {
      const double next = value(circle[i]);
      if ((last <= 0.0) != (next <= 0.0) && found(refine(circle[i - 1], circle[i], last, next))) return true;
      last = next;
    }
    return false;
  }

 private:
  static constexpr int kSamples = 24;  // of the circle
  using Samples = std::array<Vec2, kSamples + 1>;
  static const Samples& samples();
  Vec2 refine(Vec2 low, Vec2 high, double f_low, double f_high) const;
};

}  // namespace contactvi

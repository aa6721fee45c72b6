// Cubic B-splines with equal spacing (de Boor, "A practical guide to splines", 2001, chapter IX).
#pragma once

#include <Eigen/Core>

namespace contactvi {

// The four of them that are not zero in a cell, at the share t of it, and their derivatives in cells.
struct CubicSplines {
  Eigen::Vector4d value, first, second;

  explicit CubicSplines(double t) {
    const double s = 1.0 - t;
    value << s * s * s / 6.0, (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0, (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0,
        t * t * t / 6.0;
    first << -0.5 * s * s, -2.0 * t + 1.5 * t * t, 2.0 * s - 1.5 * s * s, 0.5 * t * t;
    second << s, -2.0 + 3.0 * t, -2.0 + 3.0 * s, t;
  }
};

}  // namespace contactvi

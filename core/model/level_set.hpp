// Solids as the places where a smooth function is negative.
#pragma once

#include <memory>
#include <vector>

#include "model/tree.hpp"

namespace contactvi {

// Twice continuously differentiable near its zeros, with a gradient that is not zero there.
class LevelSet {
 public:
  struct Value {
    double f;
    Vec3 gradient;
    Mat3 hessian;
  };

  LevelSet() = default;
  LevelSet(const LevelSet&) = delete;
  LevelSet& operator=(const LevelSet&) = delete;
  virtual ~LevelSet() = default;

  // Numbers that are not finite: it is not known there.
  virtual Value at(const Vec3& x) const = 0;
};

// About z: a tube of radius `tube` around a circle of radius `ring` [m].
std::unique_ptr<const LevelSet> torus(double ring, double tube);
// |x/a|^n + |y/b|^n + |z/c|^n = 1 with n >= 2.
std::unique_ptr<const LevelSet> superellipsoid(const Vec3& radii, double exponent);
// About z: at the height z it is radius + depth cos(angle - 2 pi z / pitch) from the axis [m], without an end.
std::unique_ptr<const LevelSet> thread(double radius, double depth, double pitch);
// A tricubic spline: a sum of products of cubic B-splines, that of coefficient (i, j, k) centred at corner +
// spacing (i - 1, j - 1, k - 1). Within the box of its cells, of which there are three fewer than coefficients.
std::unique_ptr<const LevelSet> spline_level_set(std::vector<double> coefficients, const Eigen::Vector3i& counts,
                                                 const Vec3& corner, const Vec3& spacing);

}  // namespace contactvi

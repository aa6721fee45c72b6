// The surface of an ellipsoid by its outward normal, or the parallel surface below it: the core of an ellipsoid that is
// swept by a sphere. As long as the depth is below the least radius of curvature, that surface is convex.
#pragma once

#include "model/placement.hpp"

namespace contactvi {

struct Ellipsoid {
  Vec3 center;
  Mat3 axes;           // columns: unit, along the half axes
  Vec3 half;           // lengths of the half axes [m]
  double inset = 0.0;  // depth of the parallel surface [m]

  // The same one, whose frame has the pose (R, p) in another frame.
  Ellipsoid in(const Mat3& R, const Vec3& p) const { return {R * center + p, R * axes, half, inset}; }

  // The point with the unit normal n.
  Vec3 point(const Vec3& n) const {
    const Vec3 k = half.cwiseProduct(axes.transpose() * n);
    return center + axes * half.cwiseProduct(k) / k.norm() - inset * n;
  }

  // The point slides by R dn where the normal n turns by dn. R is symmetric and zero along n; in the tangent plane its
  // eigenvalues are the radii of curvature: D^2 / s - (D^2 k)(D^2 k)^T / s^3, D half axes, k = n in the ellipsoid's
  // axes, s = |D k|; less the depth.
  Mat3 bend(const Vec3& n) const {
    const Vec3 k = axes.transpose() * n, square = half.cwiseAbs2(), w = square.cwiseProduct(k);
    const double s = half.cwiseProduct(k).norm();
    Mat3 R = -(w / s) * (w / s).transpose();
    R.diagonal() += square;
    return axes * (R / s) * axes.transpose() - inset * (Mat3::Identity() - n * n.transpose());
  }
};

}  // namespace contactvi

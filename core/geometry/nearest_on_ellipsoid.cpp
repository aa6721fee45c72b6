#include "geometry/nearest_on_ellipsoid.hpp"

#include <cmath>
#include <optional>

#include "geometry/core_projection.hpp"

namespace contactvi {

namespace {

// [rad] Newton's method doubles the digits with each step: where a step below this one is not followed by a smaller
// one, what is left is rounding.
constexpr double kNearlyThere = 1e-9;
constexpr double kPlaceRounding = 1e-15;  // of a place in the frame of the other body
constexpr int kEllipsoidNewton = 50, kHalvings = 30;

// Everything in the frame of the other body.
class Nearest {
 public:
  // n: the ellipsoid's outward normal.
  Nearest(const Ellipsoid& ellipsoid, const ShapeFeatures& other, const Vec3& n) : ellipsoid_(ellipsoid), n_(n) {
    if (other.ellipsoid) {
      second_ = other.ellipsoid;
    } else {
      projection_.emplace(other, -n);
    }
  }

  bool run() {
    if (!place()) return false;
    double last = INFINITY;
    for (int k = 0; k < kEllipsoidNewton; ++k) {
      const Vec3 dn = newton_step();
      const double step = dn.norm();
      if (last <= kNearlyThere && !(step < 0.5 * last)) return !projection_ || projection_->is_nearest(x_, y_);
      if (!std::isfinite(step) || !turn(dn)) return false;
      last = step;
    }
    return false;
  }

  const Vec3& normal() const { return n_; }
  const Vec3& on_ellipsoid() const { return x_; }
  const Vec3& on_other() const { return y_; }
  double distance() const { return distance_; }

 private:
  // Both points for the normal n_, and the matrix of Newton's method. False where the cores are not apart.
  bool place() {
    x_ = ellipsoid_.point(n_);
    matrix_ = ellipsoid_.bend(n_);
    if (second_) {
      y_ = second_->point(-n_);
      matrix_ += second_->bend(n_);
    } else {
      Mat3 change;
      if (!projection_->project(x_, y_, change)) return false;
      matrix_ -= change * Mat3(matrix_);
    }
    distance_ = n_.dot(y_ - x_);
    falling_ = second_ ? -distance_ : (y_ - x_).norm();
    matrix_.diagonal().array() += distance_;
    return distance_ > 0.0;
  }

  Vec3 newton_step() const {
    const Vec3 d = y_ - x_, t0 = any_tangent(n_), t1 = n_.cross(t0), m0 = matrix_ * t0, m1 = matrix_ * t1;
    const double m00 = t0.dot(m0), m01 = t0.dot(m1), m10 = t1.dot(m0), m11 = t1.dot(m1), det = m00 * m11 - m01 * m10;
    const double c0 = t0.dot(d), c1 = t1.dot(d);
    return ((m11 * c0 - m01 * c1) / det) * t0 + ((m00 * c1 - m10 * c0) / det) * t1;
  }

  // Turns the normal by dn, or by a half, a quarter of it if falling_ would rise.
  bool turn(const Vec3& dn) {
    const Vec3 n = n_;
    const double before = falling_ + kPlaceRounding * (x_.cwiseAbs().maxCoeff() + y_.cwiseAbs().maxCoeff());
    for (int k = 0; k < kHalvings; ++k) {
      n_ = (n + std::ldexp(1.0, -k) * dn).normalized();
      // Of a last step the rounding of falling_ hides the change.
      if (place() && (falling_ <= before || dn.norm() <= kNearlyThere)) return true;
    }
    return false;
  }

  Ellipsoid ellipsoid_;
  std::optional<Ellipsoid> second_;
  std::optional<CoreProjection> projection_;
  Vec3 n_, x_, y_;
  double distance_ = 0.0;
  // What Newton's steps make smaller: the distance of x from the other core, or of two ellipsoids the bound -n.(y - x).
  double falling_ = 0.0;
  Mat3 matrix_;
};

}  // namespace

bool refine_on_ellipsoid(const ShapeFeatures& a, const Pose& pose_a, const ShapeFeatures& b, const Pose& pose_b,
                         Contact& contact) {
  const bool first = a.ellipsoid.has_value();
  const ShapeFeatures &own = first ? a : b, &other = features_for_ellipsoid(first ? b : a);
  const Pose &own_pose = first ? pose_a : pose_b, &frame = first ? pose_b : pose_a;
  const double sign = first ? 1.0 : -1.0;
  const Mat3 R = frame.R.transpose() * own_pose.R;
  Nearest nearest(own.ellipsoid->in(R, frame.into(own_pose.p)), other, frame.R.transpose() * (sign * contact.normal));
  if (!nearest.run()) return false;
  const Vec3 n = frame.R * nearest.normal();
  const Vec3 x = frame.point(nearest.on_ellipsoid()) + own.radius * n;
  const Vec3 y = frame.point(nearest.on_other()) - other.radius * n;
  contact.gap = nearest.distance() - own.radius - other.radius;
  contact.normal = sign * n;
  contact.point_a = first ? x : y;
  contact.point_b = first ? y : x;
  return true;
}

}  // namespace contactvi

#include "cone/block_interior_point.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/tolerances.hpp"

namespace contactvi {

namespace {

constexpr double kLeastFriction = 1e-6;  // the coordinates stretch the normal by 1/mu
constexpr double kBoundary = 0.995;      // share of the way to the boundary of the cones
constexpr double kLeastCentering = 1e-6;
constexpr double kBlocked = 0.05;     // step below which it is aimed at the central path instead
constexpr double kPredictable = 0.1;  // predictor's step from which its product is worth correcting
constexpr double kProgress = 0.9;     // of the residual, that counts as one
constexpr int kStalled = 8;           // iterations without

double norm(const Vec3& x) { return std::sqrt(x[1] * x[1] + x[2] * x[2]); }
// x_n^2 - |x_t|^2
double determinant(const Vec3& x) {
  const double l = norm(x);
  return (x[0] - l) * (x[0] + l);
}
// Product of the cone's algebra and its inverse.
Vec3 product(const Vec3& a, const Vec3& b) { return {a.dot(b), a[0] * b[1] + b[0] * a[1], a[0] * b[2] + b[0] * a[2]}; }
Vec3 quotient(const Vec3& a, const Vec3& b) {
  const double d = std::max(determinant(a), kLeastDivisor), y = (a[0] * b[0] - a[1] * b[1] - a[2] * b[2]) / d;
  return {y, (b[1] - y * a[1]) / a[0], (b[2] - y * a[2]) / a[0]};
}
// Largest a with x + a d in the cone.
double room(const Vec3& x, const Vec3& d) {
  const double a = d[0] * d[0] - d[1] * d[1] - d[2] * d[2], b = x[0] * d[0] - x[1] * d[1] - x[2] * d[2];
  const double c = std::max(determinant(x), 0.0), root = b * b - a * c;
  double least = d[0] < 0.0 ? -x[0] / d[0] : std::numeric_limits<double>::infinity();
  if (root < 0.0) return least;
  const double q = -(b + std::copysign(std::sqrt(root), b));
  if (a != 0.0 && q / a > 0.0) least = std::min(least, q / a);
  if (q != 0.0 && c / q > 0.0) least = std::min(least, c / q);
  return least;
}
// The point of the central path above x: y with y o (y - x) = t^2.
Vec3 lift(const Vec3& x, double t) {
  const auto up = [t](double e) {
    const double root = std::sqrt(e * e + 4.0 * t * t);
    return e > 0.0 ? 0.5 * (e + root) : 2.0 * t * t / std::max(root - e, kLeastDivisor);
  };
  const double l = norm(x), p1 = up(x[0] - l), p2 = up(x[0] + l), k = l > 0.0 ? 0.5 * (p2 - p1) / l : 0.0;
  return {0.5 * (p1 + p2), k * x[1], k * x[2]};
}

}  // namespace

Vec3 BlockInteriorPoint::dual_velocity(const BlockSystem& system, int c, const VecX& v) const {
  Vec3 w = system.velocity(c, v);
  w[0] /= mu_[c];
  if (!has_friction(system.contact(c))) return Vec3(w[0], 0.0, 0.0);
  w[0] += (*slip_)[c];
  return w;
}

void BlockInteriorPoint::begin(const BlockSystem& system, double start) {
  const int m = system.contacts();
  pairs_.resize(m);
  mu_.resize(m);
  K_.resize(m);
  for (int c = 0; c < m; ++c) {
    const BlockContact& law = system.contact(c);
    pairs_[c] = Pair();
    if (is_box(law)) continue;
    mu_[c] = has_friction(law) ? std::max(law.mu, kLeastFriction) : 1.0;
    const double g = system.matrix(c).largest, t = std::max(start * system.scale() / g, kLeastDivisor);
    const Vec3& lambda = trial_.lambda[c];
    const Vec3 x = Vec3(mu_[c] * lambda[0], lambda[1], lambda[2]) - dual_velocity(system, c, trial_.v) / g;
    pairs_[c].z = lift(x, t);
    pairs_[c].s = g * lift(-x, t);
  }
  impulses(system, trial_);
  system.update(trial_);
}

// Impulses of the iterate; joint friction keeps its own.
void BlockInteriorPoint::impulses(const BlockSystem& system, BlockPoint& point) const {
  for (int c = 0; c < system.contacts(); ++c)
    if (!is_box(system.contact(c))) point.lambda[c] = Vec3(pairs_[c].z[0] / mu_[c], pairs_[c].z[1], pairs_[c].z[2]);
}

double BlockInteriorPoint::convex_residual(const BlockSystem& system, const BlockPoint& point) const {
  double worst = 0.0;
  for (int c = 0; c < system.contacts(); ++c) {
    const BlockContact& law = system.contact(c);
    if (is_box(law)) continue;
    const double g = system.matrix(c).largest;
    Vec3 w = system.velocity(c, point.v);
    if (has_friction(law)) w[0] += law.mu * (*slip_)[c];
    const double error = g * (point.lambda[c] - project_impulse(law, point.lambda[c] - w / g)).cwiseAbs().maxCoeff();
    if (!(error <= worst)) worst = error;
  }
  return worst / system.scale();
}

// Scalings and the factor of the iterate.
bool BlockInteriorPoint::prepare(const BlockSystem& system, BlockFactor& factor) {
  mean_ = 0.0;
  int cones = 0;
  for (int c = 0; c < system.contacts(); ++c) {
    Pair& p = pairs_[c];
    K_[c].setZero();
    if (is_box(system.contact(c))) continue;
    ++cones;
    mean_ += p.z.dot(p.s);
    p.error = dual_velocity(system, c, trial_.v) - p.s;
    const double dz = std::sqrt(std::max(determinant(p.z), kLeastDivisor));
    const double ds = std::sqrt(std::max(determinant(p.s), kLeastDivisor));
    const Vec3 z = p.z / dz, s = p.s / ds;
    const double gamma = std::sqrt(0.5 * (1.0 + z.dot(s))), eta = std::sqrt(ds / dz);
    const Vec3 w = Vec3(s[0] + z[0], s[1] - z[1], s[2] - z[2]) / (2.0 * gamma);
    const Vec3 tail(0.0, w[1], w[2]);
    Mat3 X = tail * tail.transpose() / (1.0 + w[0]);
    X(1, 1) += 1.0;
    X(2, 2) += 1.0;
    X(0, 0) = w[0];
    X.block<1, 2>(0, 1) = tail.tail<2>().transpose();
    X.block<2, 1>(1, 0) = tail.tail<2>();
    p.scaling = eta * X;
    X.block<1, 2>(0, 1) *= -1.0;
    X.block<2, 1>(1, 0) *= -1.0;
    p.inverse = X / eta;
    if (!has_friction(system.contact(c))) {
      K_[c](0, 0) = p.inverse(0, 0) * p.inverse(0, 0);
      continue;
    }
    K_[c].noalias() = p.inverse * p.inverse;
    K_[c].row(0) /= mu_[c];
    K_[c].col(0) /= mu_[c];
  }
  mean_ /= std::max(cones, 1);
  return factor.factor(system.problem(), K_, true);
}

// Step towards z o s = target; the largest share of it that stays inside the cones, -1 if there is none.
double BlockInteriorPoint::direction(const BlockSystem& system, BlockFactor& factor, double target, bool corrected) {
  step_.setZero(system.dofs());
  for (int c = 0; c < system.contacts(); ++c) {
    if (is_box(system.contact(c))) continue;
    Pair& p = pairs_[c];
    const Vec3 l = p.scaling * p.z;
    Vec3 right = -product(l, l);
    right[0] += target;
    if (corrected) right -= p.corrector;
    p.d = p.inverse * quotient(l, right);
    Vec3 force = p.d - p.inverse * (p.inverse * p.error);
    force[0] /= mu_[c];
    system.pull(c, force, step_);
  }
  if (!factor.solve(step_)) return -1.0;
  double share = std::numeric_limits<double>::infinity();
  for (int c = 0; c < system.contacts(); ++c) {
    if (is_box(system.contact(c))) continue;
    Pair& p = pairs_[c];
    Vec3 w = system.speed(c, step_);
    w[0] /= mu_[c];
    if (!has_friction(system.contact(c))) w.tail<2>().setZero();
    p.ds = w + p.error;
    p.dz = p.d - p.inverse * (p.inverse * p.ds);
    share = std::min({share, room(p.z, p.dz), room(p.s, p.ds)});
  }
  return share;
}

// One iteration; its length, 0 if there is none.
double BlockInteriorPoint::advance(const BlockSystem& system, BlockFactor& factor) {
  if (!prepare(system, factor)) return 0.0;
  const double predicted = std::min(1.0, direction(system, factor, 0.0, false));
  if (!(predicted >= 0.0)) return 0.0;
  for (Pair& p : pairs_) p.corrector = product(p.inverse * p.ds, p.scaling * p.dz);
  const double centering = std::max(std::pow(1.0 - predicted, 3), kLeastCentering);
  double share = direction(system, factor, centering * mean_, predicted > kPredictable);
  if (share >= 0.0 && share < kBlocked) share = direction(system, factor, std::max(centering, 0.5) * mean_, false);
  if (!(share >= 0.0)) return 0.0;
  const double length = std::min(1.0, kBoundary * share);
  for (Pair& p : pairs_) {
    p.z += length * p.dz;
    p.s += length * p.ds;
  }
  return length;
}

int BlockInteriorPoint::run(const BlockSystem& system, BlockFactor& factor, const std::vector<double>& slip,
                            double start, double tolerance, int iterations, BlockPoint& point) {
  slip_ = &slip;
  trial_ = point;
  begin(system, start);
  residual_ = std::numeric_limits<double>::infinity();
  int used = 0;
  for (int stalled = 0; used < iterations && stalled < kStalled;) {
    ++used;
    const double length = advance(system, factor);
    if (length == 0.0) break;
    impulses(system, trial_);
    system.update(trial_);
    const double residual = convex_residual(system, trial_);
    stalled = residual < kProgress * residual_ ? 0 : stalled + 1;
    if (residual < residual_) {
      residual_ = residual;
      point.lambda = trial_.lambda;
      point.v = trial_.v;
    }
    if (residual_ <= tolerance) break;
  }
  system.project(point);
  return used;
}

}  // namespace contactvi

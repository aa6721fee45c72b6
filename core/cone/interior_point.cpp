#include "cone/interior_point.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/tolerances.hpp"
#include "cone/block_factor.hpp"
#include "cone/block_system.hpp"
#include "cone/dense_system.hpp"

namespace contactvi {

namespace {

constexpr double kLeastFriction = 1e-6;  // the coordinates stretch the normal by 1/mu
// Measured on contact problems of stacks, rollers and heaps that sweeps and Newton's method do not solve
// (benchmarks/contact_problems.py): mu times the share of the coupling from .3 to 1; and, with starts from the last
// answer, the least centering from 0 to .5 and the way to the boundary from .8 to .98. These solve the most and need
// the fewest iterations, the neighbouring ones hardly fewer and more.
constexpr double kCoupling = 0.7;
constexpr double kLeastCentering = 0.25;
constexpr double kBoundary = 0.9;
constexpr double kProgress = 0.5;  // of the residual, that counts as one
constexpr int kStalled = 20;       // iterations without
constexpr double kInside = 0.1;    // share of a box that is kept from its ends at the start

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
double room(double x, double d) { return d < 0.0 ? -x / d : std::numeric_limits<double>::infinity(); }
// The number of the central path above e: x with x (x - e) = t^2, and the same in the cone's algebra.
double lift(double e, double t) {
  const double root = std::sqrt(e * e + 4.0 * t * t);
  return e > 0.0 ? 0.5 * (e + root) : 2.0 * t * t / std::max(root - e, kLeastDivisor);
}
Vec3 lift(const Vec3& x, double t) {
  const double l = norm(x), p1 = lift(x[0] - l, t), p2 = lift(x[0] + l, t), k = l > 0.0 ? 0.5 * (p2 - p1) / l : 0.0;
  return {0.5 * (p1 + p2), k * x[1], k * x[2]};
}

}  // namespace

// Velocities of the iterate in the pairs' coordinates, and what is wrong with those of the pairs.
template <class System, class Factor>
void InteriorPoint<System, Factor>::read_velocities(const System& system) {
  for (int c = 0; c < system.contacts(); ++c) {
    Pair& p = pairs_[c];
    Vec3 w = system.velocity(c, iterate_.v);
    p.slip.setZero();
    if (p.cone) {
      const double speed = norm(w);
      if (frozen_ == nullptr && speed > 0.0) p.slip = Vec3(0.0, w[1], w[2]) * (std::min(1.0, kCoupling / p.mu) / speed);
      w[0] = w[0] / p.mu + (frozen_ == nullptr ? speed : (*frozen_)[c]);
    } else {
      w.tail<2>().setZero();
    }
    p.error = w - p.y;
    p.error[0] += p.upper.force - p.lower.force;
  }
}

template <class System, class Factor>
void InteriorPoint<System, Factor>::begin_bounds(const BlockContact& law, double g, double t, double lambda, double w,
                                                 Pair& p) const {
  if (is_box(law)) {
    const double inside = std::min(t, kInside * law.box);
    p.z[0] = std::clamp(lambda - w / g, inside - law.box, law.box - inside);
    p.lower = {true, p.z[0] + law.box, g * lift(w / g, t)};
    p.upper = {true, law.box - p.z[0], g * lift(-w / g, t)};
    return;
  }
  const double least = p.mu * law.lower, e = p.mu * lambda - least - w / g;
  if (!p.cone) p.z[0] = least + lift(e, t);
  p.z[0] = std::max(p.z[0], least + t);
  p.lower = {true, p.z[0] - least, g * lift(-e, t)};
}

template <class System, class Factor>
void InteriorPoint<System, Factor>::begin(const System& system) {
  const int m = system.contacts();
  pairs_.resize(m);
  K_.resize(m);
  iterate_.lambda.assign(m, Vec3::Zero());
  system.project(iterate_);
  for (int c = 0; c < m; ++c) {
    const BlockContact& law = system.contact(c);
    Pair& p = pairs_[c];
    p = Pair();
    p.cone = has_friction(law);
    if (p.cone) p.mu = std::max(law.mu, kLeastFriction);
    const double g = system.largest(c), t = std::max(system.scale() / g, kLeastDivisor);
    const Vec3& lambda = iterate_.lambda[c];
    Vec3 w = system.velocity(c, iterate_.v);
    w[0] /= p.mu;
    if (p.cone) {
      w[0] += frozen_ == nullptr ? norm(w) : (*frozen_)[c];
      const Vec3 x = Vec3(p.mu * lambda[0], lambda[1], lambda[2]) - w / g;
      p.z = lift(x, t);
      p.y = g * lift(-x, t);
    }
    if (!p.cone || law.lower > 0.0) begin_bounds(law, g, t, lambda[0], w[0], p);
  }
  impulses(system);
}

// The iterate's impulses, and the velocity that belongs to them.
template <class System, class Factor>
void InteriorPoint<System, Factor>::impulses(const System& system) {
  for (int c = 0; c < system.contacts(); ++c) {
    const Pair& p = pairs_[c];
    iterate_.lambda[c] = Vec3(p.z[0] / p.mu, p.z[1], p.z[2]);
  }
  system.update(iterate_);
  read_velocities(system);
}

// Of the law, or of the convex problem.
template <class System, class Factor>
double InteriorPoint<System, Factor>::residual(const System& system, const ConePoint& point) const {
  if (frozen_ == nullptr) return system.residual(point);
  double worst = 0.0;
  for (int c = 0; c < system.contacts(); ++c) {
    const BlockContact& law = system.contact(c);
    const double g = system.largest(c);
    Vec3 w = system.velocity(c, point.v);
    if (has_friction(law)) w[0] += law.mu * (*frozen_)[c];
    const double error = g * (point.lambda[c] - project_impulse(law, point.lambda[c] - w / g)).cwiseAbs().maxCoeff();
    if (!(error <= worst)) worst = error;
  }
  return worst / system.scale();
}

template <class System, class Factor>
void InteriorPoint<System, Factor>::set_scaling(Pair& p) const {
  const double dz = std::sqrt(std::max(determinant(p.z), kLeastDivisor));
  const double dy = std::sqrt(std::max(determinant(p.y), kLeastDivisor));
  const Vec3 z = p.z / dz, y = p.y / dy;
  const double gamma = std::sqrt(0.5 * (1.0 + z.dot(y))), eta = std::sqrt(dy / dz);
  const Vec3 w = Vec3(y[0] + z[0], y[1] - z[1], y[2] - z[2]) / (2.0 * gamma);
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
}

// Scalings and the factor of the iterate.
template <class System, class Factor>
bool InteriorPoint<System, Factor>::prepare(const System& system, Factor& factor) {
  mean_ = 0.0;
  int count = 0;
  for (int c = 0; c < system.contacts(); ++c) {
    Pair& p = pairs_[c];
    double stiffness = 0.0;  // of the bounds
    for (const Bound* b : {&p.lower, &p.upper}) {
      if (!b->present) continue;
      ++count;
      mean_ += b->room * b->force;
      stiffness += b->force / b->room;
    }
    p.mobility.setZero();
    if (p.cone) {
      ++count;
      mean_ += p.z.dot(p.y);
      set_scaling(p);
      p.mobility.noalias() = p.inverse * p.inverse;
      const Vec3 column = p.mobility.col(0);
      if (stiffness > 0.0) p.mobility -= column * column.transpose() * (stiffness / (1.0 + stiffness * column[0]));
    } else {
      p.mobility(0, 0) = 1.0 / std::max(stiffness, kLeastDivisor);
    }
    Mat3 C = Mat3::Identity();  // derivative of the pair's velocity
    C.row(0) = Vec3(1.0 / p.mu, p.slip[1], p.slip[2]).transpose();
    K_[c].noalias() = p.mobility * C;
    K_[c].row(0) /= p.mu;
  }
  mean_ /= std::max(count, 1);
  return factor.factor(system, K_, frozen_ != nullptr);
}

// Step towards products of `target` in all pairs; the largest share of it that stays inside, -1 if there is none.
template <class System, class Factor>
double InteriorPoint<System, Factor>::direction(const System& system, Factor& factor, double target, bool corrected) {
  step_.setZero(system.dofs());
  for (int c = 0; c < system.contacts(); ++c) {
    Pair& p = pairs_[c];
    p.d = -p.error;
    if (p.cone) {
      const Vec3 l = p.scaling * p.z;
      Vec3 right = -product(l, l);
      right[0] += target;
      if (corrected) right -= p.corrector;
      p.d += p.scaling * quotient(l, right);
    }
    for (Bound* b : {&p.lower, &p.upper}) {
      if (!b->present) continue;
      b->d = (target - (corrected ? b->corrector : 0.0)) / b->room - b->force;
      p.d[0] += b == &p.lower ? b->d : -b->d;
    }
    Vec3 force = p.mobility * p.d;
    force[0] /= p.mu;
    system.pull(c, force, step_);
  }
  if (!factor.solve(step_)) return -1.0;
  double share = std::numeric_limits<double>::infinity();
  for (int c = 0; c < system.contacts(); ++c) {
    Pair& p = pairs_[c];
    Vec3 w = system.speed(c, step_);
    w[0] = w[0] / p.mu + p.slip.dot(w);
    if (!p.cone) w.tail<2>().setZero();
    p.dz = p.mobility * (p.d - w);
    p.dy = w + p.error;
    for (Bound* b : {&p.lower, &p.upper}) {
      if (!b->present) continue;
      const double sign = b == &p.lower ? 1.0 : -1.0;
      b->d_room = sign * p.dz[0];
      b->d_force = b->d - b->force / b->room * b->d_room;
      p.dy[0] -= sign * b->d_force;
      share = std::min({share, room(b->room, b->d_room), room(b->force, b->d_force)});
    }
    if (p.cone) share = std::min({share, room(p.z, p.dz), room(p.y, p.dy)});
  }
  return share;
}

// One iteration. False if there is none.
template <class System, class Factor>
bool InteriorPoint<System, Factor>::advance(const System& system, Factor& factor) {
  if (!prepare(system, factor)) return false;
  const double predicted = std::min(1.0, direction(system, factor, 0.0, false));
  if (!(predicted >= 0.0)) return false;
  for (Pair& p : pairs_) {
    if (p.cone) p.corrector = product(p.inverse * p.dy, p.scaling * p.dz);
    for (Bound* b : {&p.lower, &p.upper}) b->corrector = b->d_room * b->d_force;
  }
  const double centering = std::max(std::pow(1.0 - predicted, 3), kLeastCentering);
  const double share = direction(system, factor, centering * mean_, true);
  if (!(share > 0.0)) return false;
  const double length = std::min(1.0, kBoundary * share);
  for (Pair& p : pairs_) {
    p.z += length * p.dz;
    if (p.cone) p.y += length * p.dy;
    for (Bound* b : {&p.lower, &p.upper}) {
      b->room += length * b->d_room;
      b->force += length * b->d_force;
    }
  }
  impulses(system);
  return true;
}

template <class System, class Factor>
int InteriorPoint<System, Factor>::run(const System& system, Factor& factor, Frozen frozen, double tolerance,
                                       int iterations, ConePoint& point) {
  frozen_ = frozen;
  begin(system);
  int used = 0, stalled = 0;
  double least = point.residual;
  while (used < iterations && stalled < kStalled && point.residual > tolerance) {
    ++used;
    if (!advance(system, factor)) break;
    projected_.lambda = iterate_.lambda;
    system.project(projected_);
    projected_.residual = residual(system, projected_);
    if (projected_.residual < point.residual) point = projected_;
    ++stalled;
    if (point.residual < kProgress * least) {
      least = point.residual;
      stalled = 0;
    }
  }
  return used;
}

template class InteriorPoint<BlockSystem, BlockFactor>;
template class InteriorPoint<DenseSystem, DenseFactor>;

}  // namespace contactvi

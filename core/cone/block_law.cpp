#include "cone/block_law.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>

#include "base/tolerances.hpp"

namespace contactvi {

namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();
// Share of the shift of the natural map's derivative that small friction may add: the cone's dual coordinates stretch
// the normal by 1/mu, hence the stiffness of a closed contact by 1/mu^2.
constexpr double kLargestShift = 1e-4;
constexpr int kSlipIterations = 60;  // Newton's method in a bracket; bisection alone would need about 60

double length(const Vec3& x) { return std::sqrt(x[1] * x[1] + x[2] * x[2]); }

// x_t cut to the disc of a radius.
Vec3 in_disc(double normal, const Vec3& x, double radius) {
  const double l = length(x), share = l > radius ? radius / l : 1.0;
  return Vec3(normal, share * x[1], share * x[2]);
}

// |t| = mu n, t = -(S + alpha)^-1 c, n = n_0 - k.t, in the principal axes of S: alpha >= 0 is the slip speed over the
// friction. At alpha = 0 friction is too large, at infinity it is zero: there is a root.
struct Slip {
  Vec2 c, k, s;
  double n_0, mu;
  Vec2 t = Vec2::Zero();
  double slope = 0.0, size = 0.0;

  double normal() const { return n_0 - k.dot(t); }
  double value(double alpha) {
    const Vec2 soft(s[0] + alpha, s[1] + alpha);
    t = -c.cwiseQuotient(soft);
    const double l = t.norm(), d0 = -t[0] / soft[0], d1 = -t[1] / soft[1];
    slope = (l > 0.0 ? (t[0] * d0 + t[1] * d1) / l : 0.0) + mu * (k[0] * d0 + k[1] * d1);
    size = l + mu * n_0;
    return l - mu * normal();
  }
  void solve(double alpha) {
    double low = 0.0, high = std::numeric_limits<double>::infinity();
    for (int i = 0; i < kSlipIterations; ++i) {
      const double f = value(alpha);
      if (std::abs(f) <= 4.0 * kEps * size) return;
      (f > 0.0 ? low : high) = alpha;
      double next = slope < 0.0 ? alpha - f / slope : -1.0;
      if (!(next > low) || next >= high) next = std::isfinite(high) ? 0.5 * (low + high) : 4.0 * alpha + s[1];
      if (!std::isfinite(high) && i > 6) next = std::max(next, 4.0 * alpha + s[1]);
      if (next == alpha) return;
      alpha = next;
    }
    value(alpha);
  }
};

// Friction at the lower bound, t = -(G_tt + alpha)^-1 (b_t + G_tn lower) within the disc of radius mu lower.
Vec3 solve_at_lower(const BlockContact& c, const ContactMatrix& m, const Vec3& b) {
  const Mat2 G = m.G.block<2, 2>(1, 1);
  Eigen::SelfAdjointEigenSolver<Mat2> eigen;
  eigen.computeDirect(G);
  const Vec2 force = b.tail<2>() + m.G.block<2, 1>(1, 0) * c.lower;
  Slip slip{eigen.eigenvectors().transpose() * force, Vec2::Zero(), eigen.eigenvalues().cwiseMax(kOwnShift * m.largest),
            c.lower, c.mu};
  if (slip.value(0.0) > 0.0) slip.solve(0.0);
  const Vec2 t = eigen.eigenvectors() * slip.t;
  return in_disc(c.lower, Vec3(0.0, t[0], t[1]), c.mu * c.lower);
}

// Matrix that is symmetric in the frame (n, d, across d): entries nn, nd, dd and the one across.
Mat3 along(const Vec2& d, double nn, double nd, double dd, double across) {
  Mat3 X;
  const double e = dd - across;
  X << nn, nd * d[0], nd * d[1],                             //
      nd * d[0], across + e * d[0] * d[0], e * d[0] * d[1],  //
      nd * d[1], e * d[0] * d[1], across + e * d[1] * d[1];
  return X;
}

// A projection in the dual coordinates at x: its value, and for a function f(D, 1 - D) of its derivative the matrix.
struct Projected {
  Vec2 d = Vec2(1.0, 0.0);
  Vec3 value;
  bool at_lower = false;
  double first, second, across;              // eigenvalues of D
  double off_first, off_second, off_across;  // 1 - D, without cancellation

  Projected(const Vec3& x, double lower) {
    const double l = length(x), e1 = x[0] - l, e2 = x[0] + l;
    if (l > 0.0) d = Vec2(x[1] / l, x[2] / l);
    const double p1 = std::max(e1, 0.0), p2 = std::max(e2, 0.0);
    value = Vec3(0.5 * (p1 + p2), 0.5 * (p2 - p1) * d[0], 0.5 * (p2 - p1) * d[1]);
    at_lower = value[0] < lower;
    if (at_lower) {
      value = in_disc(lower, x, lower);
      set(first, off_first, 0.0);
      set(second, off_second, l <= lower ? 1.0 : 0.0);
      across = l <= lower ? 1.0 : lower / l;
      off_across = l <= lower ? 0.0 : (l - lower) / l;
      return;
    }
    set(first, off_first, e1 > 0.0 ? 1.0 : 0.0);
    set(second, off_second, e2 > 0.0 ? 1.0 : 0.0);
    if (e1 > 0.0 || e2 <= 0.0) {
      set(across, off_across, e1 > 0.0 ? 1.0 : 0.0);
    } else {
      across = 0.5 * e2 / l;
      off_across = -0.5 * e1 / l;
    }
  }
  static void set(double& on, double& off, double value) {
    on = value;
    off = 1.0 - value;
  }
  // f of the eigenvalues; on the cone they belong to (1, -d) and (1, d), at the bound to n and d.
  template <class F>
  Mat3 matrix(F f) const {
    const double a = f(first, off_first), b = f(second, off_second), c = f(across, off_across);
    return at_lower ? along(d, a, 0.0, b, c) : along(d, 0.5 * (a + b), 0.5 * (b - a), 0.5 * (a + b), c);
  }
};

// Impulse minus step along the velocity, in the dual coordinates.
Vec3 dual_step(const BlockContact& c, double g, const Vec3& lambda, const Vec3& w) {
  return Vec3(c.mu * lambda[0] - (w[0] / c.mu + length(w)) / g, lambda[1] - w[1] / g, lambda[2] - w[2] / g);
}

// The natural map of a contact without friction: value, and whether its derivative D is 1.
double scalar_map(const BlockContact& c, double g, double lambda, double w, bool& free) {
  const double x = lambda - w / g;
  free = is_box(c) ? std::abs(x) < c.box : x > c.lower;
  if (free) return w / g;
  return lambda - (is_box(c) ? std::copysign(c.box, x) : c.lower);
}

}  // namespace

void ContactMatrix::finish(double floor, bool single) {
  largest = std::max(G.diagonal().maxCoeff(), floor);
  G.diagonal().array() += kOwnShift * largest;
  G(0, 0) = std::max(G(0, 0), kOwnShift * largest);
  if (single) return;
  coupling = G.block<2, 1>(1, 0) / G(0, 0);
  const Mat2 S = G.block<2, 2>(1, 1) - coupling * G.block<1, 2>(0, 1);
  Eigen::SelfAdjointEigenSolver<Mat2> eigen;
  eigen.computeDirect(S);
  axes = eigen.eigenvectors();
  stiffness = eigen.eigenvalues().cwiseMax(0.5 * kOwnShift * largest);
}

Vec3 project_impulse(const BlockContact& c, const Vec3& x) {
  if (is_box(c)) return Vec3(std::clamp(x[0], -c.box, c.box), 0.0, 0.0);
  if (!has_friction(c)) return Vec3(std::max(x[0], c.lower), 0.0, 0.0);
  const double l = length(x);
  if (l > c.mu * x[0]) {
    const double normal = (x[0] + c.mu * l) / (1.0 + c.mu * c.mu);
    if (normal > c.lower) return in_disc(normal, x, c.mu * normal);
  } else if (x[0] >= c.lower) {
    return x;
  }
  return in_disc(c.lower, x, c.mu * c.lower);
}

double law_error(const BlockContact& c, double g, const Vec3& lambda, const Vec3& w) {
  const Vec3 x(lambda[0] - (w[0] + (has_friction(c) ? c.mu * length(w) : 0.0)) / g, lambda[1] - w[1] / g,
               lambda[2] - w[2] / g);
  return g * (lambda - project_impulse(c, x)).cwiseAbs().maxCoeff();
}

Vec3 solve_contact(const BlockContact& c, const ContactMatrix& m, const Vec3& b, const Vec3& previous) {
  const double n_0 = -b[0] / m.G(0, 0);
  if (is_box(c)) return Vec3(std::clamp(n_0, -c.box, c.box), 0.0, 0.0);
  if (!has_friction(c)) return Vec3(std::max(n_0, c.lower), 0.0, 0.0);
  if (b[0] >= 0.0) return c.lower > 0.0 ? solve_at_lower(c, m, b) : Vec3(Vec3::Zero());
  Slip slip{m.axes.transpose() * (b.tail<2>() - m.coupling * b[0]), m.axes.transpose() * m.coupling, m.stiffness, n_0,
            c.mu};
  if (slip.value(0.0) > 0.0) {
    const double friction = length(previous);
    double alpha = 0.0;
    if (friction > 0.0) alpha = (b.tail<2>() + m.G.block<2, 3>(1, 0) * previous).norm() / friction;
    slip.solve(std::isfinite(alpha) ? alpha : 0.0);
  }
  const double normal = std::max(slip.normal(), 0.0);
  if (normal < c.lower) return solve_at_lower(c, m, b);
  const Vec2 t = m.axes * slip.t;
  return in_disc(normal, Vec3(0.0, t[0], t[1]), c.mu * normal);
}

LawTangent law_tangent(const BlockContact& c, double g, const Vec3& lambda, const Vec3& w, double shift) {
  LawTangent tangent{Mat3::Zero(), Vec3::Zero()};
  if (!has_friction(c)) {
    bool free = false;
    const double map = scalar_map(c, g, lambda[0], w[0], free), off = free ? shift : 1.0 + shift;
    tangent.K(0, 0) = free ? 1.0 / (off * g) : 0.0;
    tangent.start = Vec3(-map / off, -lambda[1], -lambda[2]);
    return tangent;
  }
  shift = std::max(shift, std::min(shift / (c.mu * c.mu), kLargestShift));
  const Vec3 scaled(c.mu * lambda[0], lambda[1], lambda[2]);
  const Projected p(dual_step(c, g, lambda, w), c.mu * c.lower);
  const Mat3 Q = p.matrix([&](double, double off) { return 1.0 / (off + shift); });
  Mat3 C = Mat3::Identity();  // derivative of the dual velocity
  C(0, 0) = 1.0 / c.mu;
  const double slip = std::max(length(w), kLeastDivisor);
  C(0, 1) = w[1] / slip;
  C(0, 2) = w[2] / slip;
  const Mat3 D = p.matrix([&](double on, double off) { return on / (off + shift); });
  tangent.K.noalias() = D * C / g;
  tangent.start.noalias() = -(Q * (scaled - p.value));
  tangent.K.row(0) /= c.mu;
  tangent.start[0] /= c.mu;
  return tangent;
}

double law_merit(const BlockContact& c, double g, const Vec3& lambda, const Vec3& w) {
  if (!has_friction(c)) {
    bool free = false;
    const double map = g * scalar_map(c, g, lambda[0], w[0], free);
    return map * map;
  }
  const Projected p(dual_step(c, g, lambda, w), c.mu * c.lower);
  return (g * (Vec3(c.mu * lambda[0], lambda[1], lambda[2]) - p.value)).squaredNorm();
}

}  // namespace contactvi

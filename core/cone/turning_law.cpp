#include "cone/turning_law.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "cone/block_law.hpp"

namespace contactvi {

namespace {

constexpr double kLocalShift = 1e-12;    // of the natural map's derivative, where the own matrix is shifted besides
constexpr int kLocalSteps = 40;          // of Newton's method, or projected ones
constexpr int kLocalHalvings = 4;        // of a step
constexpr double kLocalSolved = 1e-13;   // of the velocities
constexpr double kLocalDecrease = 1e-3;  // share of the expected decrease of the merit that is asked for

// One kind of friction: its first row and number of rows, the radius of its ball by the normal impulse, its scale.
template <int N>
struct Ball {
  using Rows = Eigen::Matrix<double, N, 1>;
  Rows e = Rows::Zero();  // unit vector along lambda - w/g where it slips
  double beta = 1.0;      // radius / |lambda - w/g| there
  bool slips = false, none = false;

  Ball(const Rows& lambda, const Rows& w, double radius, double g) {
    const Rows z = lambda - w / g;
    const double length = z.norm();
    none = !(radius > 0.0);
    slips = !none && length > radius;
    if (!slips) return;
    e = z / length;
    beta = radius / length;
  }
  Rows map(const Rows& lambda, const Rows& w, double radius, double g) const {
    if (none) return g * lambda;
    return slips ? Rows(g * (lambda - radius * e)) : w;
  }
};

// The rows [first, first + N) of the linearisation. coefficient: d radius / d rho; n: d rho = start[0] - (K(0, 0) +
// 1/g_n) d w_n where the contact is closed.
template <int N>
void add_ball(const Ball<N>& ball, int first, const Vec6& map, double g, double coefficient, double inverse_normal,
              bool closed, double shift, TurningTangent& t) {
  using Rows = Eigen::Matrix<double, N, 1>;
  using Square = Eigen::Matrix<double, N, N>;
  const Rows f = map.segment<N>(first) / g;
  auto start = t.start.segment<N>(first);
  auto K = t.K.block<N, N>(first, first);
  if (ball.none) {
    start = -f / (1.0 + shift);
  } else if (!ball.slips) {
    start = -f / shift;
    K = Square::Identity() / (shift * g);
  } else {
    const Square along = ball.e * ball.e.transpose(), across = Square::Identity() - along;
    const double off = 1.0 - ball.beta + shift;
    start = -(along * f) / (1.0 + shift) - (across * f) / off;
    K = across * (ball.beta / (off * g));
    if (!closed) return;
    start += ball.e * (coefficient * t.start[0] / (1.0 + shift));
    t.K.template block<N, 1>(first, 0) = ball.e * (coefficient * (t.K(0, 0) + inverse_normal) / (1.0 + shift));
  }
}

double bound_of(const BlockContact& c, const TurningMatrix& m, const Vec6& lambda, const Vec6& w, bool& closed) {
  const double z = lambda[0] - w[0] / m.normal;
  closed = z > c.lower;
  return closed ? z : c.lower;
}

double largest_sum(const Mat6& G, int first, int count) {
  return G.block(first, first, count, count).cwiseAbs().rowwise().sum().maxCoeff();
}

// Each kind of friction in turn, a projected step against its velocity.
Vec6 projected_step(const BlockContact& c, const TurningMatrix& m, const Vec6& b, const Vec6& previous) {
  Vec6 lambda = previous;
  lambda[0] = std::max(c.lower, lambda[0] - (b[0] + m.G.row(0).dot(lambda)) / m.normal);
  const auto step = [&](auto rows, double radius, double g) {
    constexpr int kCount = decltype(rows)::RowsAtCompileTime;
    const int first = kCount == 3 ? 1 : 4;
    rows = lambda.segment<kCount>(first) - (b + m.G * lambda).template segment<kCount>(first) / g;
    const double length = rows.norm();
    lambda.segment<kCount>(first) = length > radius ? decltype(rows)(rows * (radius / length)) : rows;
  };
  step(Vec3(), c.mu * lambda[0], m.slip);
  step(Eigen::Vector2d(), lambda[0], m.rolling);
  return lambda;
}

}  // namespace

void TurningMatrix::finish(double floor) {
  const double largest = std::max(G.diagonal().maxCoeff(), floor);
  G.diagonal().array() += kOwnShift * largest;
  normal = std::max(G(0, 0), floor);
  slip = std::max(largest_sum(G, 1, 3), floor);
  rolling = std::max(largest_sum(G, 4, 2), floor);
}

double least_normal(double mu, const Vec3& point, const Vec3& turning) {
  const double slip = Vec3(point[1], point[2], turning[0]).norm();
  return std::max(mu > 0.0 ? slip / mu : 0.0, turning.tail<2>().norm());
}

Vec6 project_turning(const BlockContact& c, const Vec6& lambda) {
  Vec6 x = lambda;
  x[0] = std::max(x[0], c.lower);
  const double slip = x.segment<3>(1).norm(), rolling = x.tail<2>().norm();
  if (slip > c.mu * x[0]) x.segment<3>(1) *= c.mu * x[0] / slip;
  if (rolling > x[0]) x.tail<2>() *= x[0] / rolling;
  return x;
}

Vec6 turning_map(const BlockContact& c, const TurningMatrix& m, const Vec6& lambda, const Vec6& w) {
  bool closed = false;
  const double rho = bound_of(c, m, lambda, w, closed);
  Vec6 map;
  map[0] = closed ? w[0] : m.normal * (lambda[0] - c.lower);
  const Vec3 l_t = lambda.segment<3>(1), w_t = w.segment<3>(1);
  const Eigen::Vector2d l_r = lambda.tail<2>(), w_r = w.tail<2>();
  map.segment<3>(1) = Ball<3>(l_t, w_t, c.mu * rho, m.slip).map(l_t, w_t, c.mu * rho, m.slip);
  map.tail<2>() = Ball<2>(l_r, w_r, rho, m.rolling).map(l_r, w_r, rho, m.rolling);
  return map;
}

double turning_merit(const TurningMatrix& m, const Vec6& map) {
  return map[0] * map[0] +
         m.normal * (map.segment<3>(1).squaredNorm() / m.slip + map.tail<2>().squaredNorm() / m.rolling);
}

TurningTangent turning_tangent(const BlockContact& c, const TurningMatrix& m, const Vec6& lambda, const Vec6& w,
                               double shift) {
  bool closed = false;
  const double rho = bound_of(c, m, lambda, w, closed), inverse = 1.0 / m.normal;
  const Vec6 map = turning_map(c, m, lambda, w);
  TurningTangent t{Mat6::Zero(), Vec6::Zero()};
  t.K(0, 0) = closed ? inverse / shift : 0.0;
  t.start[0] = -map[0] * inverse / (closed ? shift : 1.0 + shift);
  add_ball<3>(Ball<3>(lambda.segment<3>(1), w.segment<3>(1), c.mu * rho, m.slip), 1, map, m.slip, c.mu, inverse, closed,
              shift, t);
  add_ball<2>(Ball<2>(lambda.tail<2>(), w.tail<2>(), rho, m.rolling), 4, map, m.rolling, 1.0, inverse, closed, shift,
              t);
  return t;
}

Vec6 solve_turning_contact(const BlockContact& c, const TurningMatrix& m, const Vec6& b, const Vec6& previous) {
  if (b[0] >= 0.0 && c.lower == 0.0) return Vec6::Zero();
  Vec6 lambda = previous, w = b + m.G * lambda;
  const auto merit = [&](const Vec6& x) { return turning_merit(m, turning_map(c, m, x, b + m.G * x)); };
  double error = merit(lambda);
  const double goal = kLocalSolved * kLocalSolved * turning_merit(m, b.cwiseAbs() + m.G.cwiseAbs() * lambda.cwiseAbs());
  for (int k = 0; k < kLocalSteps && error > goal; ++k) {
    const TurningTangent t = turning_tangent(c, m, lambda, w, kLocalShift);
    const Vec6 change = (Mat6::Identity() + t.K * m.G).partialPivLu().solve(t.start);
    Vec6 next = lambda + change;
    double after = merit(next), length = 1.0;
    for (int half = 0; half < kLocalHalvings && !(after < (1.0 - kLocalDecrease * length) * error); ++half) {
      length *= 0.5;
      next = lambda + length * change;
      after = merit(next);
    }
    if (!(after < (1.0 - kLocalDecrease * length) * error)) {
      next = projected_step(c, m, b, lambda);
      after = merit(next);
    }
    lambda = next;
    w = b + m.G * lambda;
    error = after;
  }
  return lambda.allFinite() ? project_turning(c, lambda) : projected_step(c, m, b, previous);
}

}  // namespace contactvi

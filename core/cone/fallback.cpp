#include "cone/fallback.hpp"

#include <algorithm>
#include <cmath>

#include "cone/single_contact.hpp"

namespace contactvi {

namespace {

constexpr double kSeidelGoal = 1e-12;  // relative change of the impulses in the last sweep
constexpr double kLocalShift = 1e-10;  // of a singular contact's largest diagonal
constexpr double kAdmmGoal = 1e-10;    // primal and dual residual, relative to their terms
constexpr int kAdmmIterations = 3000, kAdaptEvery = 20;

using Vec2 = Eigen::Vector2d;

// De Saxce's correction: with it added to the normal velocity the law says that -w is in the normal cone of the set of
// admissible lambda.
double correction(const ConeContact& c, const double* w) {
  if (c.rows == 1) return 0.0;
  return c.frozen ? c.mu * (c.d[0] * w[1] + c.d[1] * w[2]) : c.mu * std::sqrt(w[1] * w[1] + w[2] * w[2]);
}

// Nearest admissible point y to p: on a half line, in the cone cut off at the lower bound, or on a ray.
void project(const ConeContact& c, double scale, const double* p, double* y) {
  const double lower = c.lower / scale, box = c.box / scale;
  if (c.box > 0.0) {
    y[0] = c.frozen ? -box * c.d[0] : std::min(box, std::max(-box, p[0]));
    return;
  }
  if (c.rows == 1) {
    y[0] = std::max(lower, p[0]);
    return;
  }
  const Vec2 p_t(p[1], p[2]);
  if (c.frozen) {
    const double along = (p[0] - c.mu * c.d.dot(p_t)) / (1.0 + c.mu * c.mu * c.d.squaredNorm());
    y[0] = std::max(lower, along);
    y[1] = -c.mu * y[0] * c.d[0];
    y[2] = -c.mu * y[0] * c.d[1];
    return;
  }
  const double length = p_t.norm();
  y[0] = p[0];
  if (length > c.mu * p[0]) y[0] = std::max(0.0, (p[0] + c.mu * length) / (1.0 + c.mu * c.mu));
  y[0] = std::max(lower, y[0]);
  const double radius = c.mu * y[0], factor = length > radius ? radius / length : 1.0;
  y[1] = factor * p[1];
  y[2] = factor * p[2];
}

}  // namespace

void ConeFallback::reserve(int rows) {
  if (static_cast<int>(x_.size()) >= rows) return;
  linear_.reserve(rows);
  for (auto* v : {&scale_, &x_, &y_, &z_, &y_old_}) v->resize(rows);
}

void ConeFallback::gauss_seidel(const ConeProblem& problem, const NaturalMap& map, int iterations, double* lambda) {
  const int m = static_cast<int>(problem.b.size());
  Eigen::Map<VecX> all(lambda, m);
  for (int s = 0; s < iterations; ++s) {
    double change = 0.0, size = 0.0;
    int i = 0;
    for (const ConeContact& c : problem.contacts) {
      Mat3 A = Mat3::Zero();
      Vec3 b = Vec3::Zero(), old = Vec3::Zero(), found;
      for (int k = 0; k < c.rows; ++k) {
        old[k] = lambda[c.row + k];
        b[k] = problem.b[c.row + k] + problem.G.row(c.row + k).dot(all);
        for (int j = 0; j < c.rows; ++j) A(k, j) = problem.G(c.row + k, c.row + j);
      }
      b -= A * old;
      A.diagonal().array() += map.shift(i);
      if (!solve_one_contact(c, A, b, found)) {
        A.diagonal().array() += kLocalShift * A.diagonal().cwiseAbs().maxCoeff();
        solve_one_contact(c, A, b, found);
      }
      change = std::max(change, (found - old).cwiseAbs().maxCoeff());
      size = std::max(size, found.cwiseAbs().maxCoeff());
      for (int k = 0; k < c.rows; ++k) lambda[c.row + k] = found[k];
      ++i;
    }
    if (!(change > kSeidelGoal * size)) return;
  }
}

bool ConeFallback::factor(const ConeProblem& problem, const NaturalMap& map, double rho) {
  const int m = static_cast<int>(problem.b.size());
  linear_.resize(m);
  for (int j = 0; j < m; ++j)
    for (int i = 0; i < m; ++i) linear_.at(i, j) = scale_[i] * problem.G(i, j) * scale_[j];
  int i = 0;
  for (const ConeContact& c : problem.contacts) {
    for (int k = c.row; k < c.row + c.rows; ++k) linear_.at(k, k) += map.shift(i) * scale_[k] * scale_[k] + rho;
    ++i;
  }
  return linear_.factor();
}

bool ConeFallback::admm(const ConeProblem& problem, const NaturalMap& map, double* lambda) {
  const int m = static_cast<int>(problem.b.size());
  int i = 0;
  for (const ConeContact& c : problem.contacts) {  // one scale per contact keeps its cone a cone
    for (int k = c.row; k < c.row + c.rows; ++k) scale_[k] = 1.0 / std::sqrt(map.tangent_scale(i));
    ++i;
  }
  for (int k = 0; k < m; ++k) {
    y_[k] = lambda[k] / scale_[k];
    z_[k] = 0.0;
  }
  double rho = 0.1;
  if (!factor(problem, map, rho)) return false;
  bool reached = false;
  for (int iteration = 1; iteration <= kAdmmIterations && !reached; ++iteration) {
    for (int k = 0; k < m; ++k) x_[k] = z_[k] + rho * y_[k] - scale_[k] * problem.b[k];
    for (const ConeContact& c : problem.contacts) x_[c.row] -= correction(c, z_.data() + c.row);
    linear_.substitute(x_.data());
    std::swap(y_, y_old_);
    double primal = 0.0, dual = 0.0, size_x = 0.0, size_z = 0.0;
    for (const ConeContact& c : problem.contacts) {
      double p[3] = {0.0, 0.0, 0.0};
      for (int k = 0; k < c.rows; ++k) p[k] = x_[c.row + k] - z_[c.row + k] / rho;
      project(c, scale_[c.row], p, y_.data() + c.row);
    }
    for (int k = 0; k < m; ++k) {
      z_[k] -= rho * (x_[k] - y_[k]);
      primal = std::max(primal, std::abs(x_[k] - y_[k]));
      dual = std::max(dual, rho * std::abs(y_[k] - y_old_[k]));
      size_x = std::max(size_x, std::abs(y_[k]));
      size_z = std::max({size_z, std::abs(z_[k]), std::abs(scale_[k] * problem.b[k])});
    }
    reached = primal <= kAdmmGoal * size_x && dual <= kAdmmGoal * size_z;
    if (!reached && iteration % kAdaptEvery == 0) {
      const double ratio = (primal * size_z) / std::max(dual * size_x, kLeastDivisor);
      if (!(ratio > 10.0) && !(ratio < 0.1)) continue;
      rho = std::min(1e6, std::max(1e-8, rho * (ratio > 10.0 ? 3.0 : 1.0 / 3.0)));
      if (!factor(problem, map, rho)) return false;
    }
  }
  for (int k = 0; k < m; ++k) lambda[k] = scale_[k] * y_[k];
  return reached;
}

}  // namespace contactvi

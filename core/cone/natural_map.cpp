#include "cone/natural_map.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace contactvi {

namespace {

// Shift as a share of max diag G: a smaller one amplifies rounding, from a larger one the unshifted solution is far.
constexpr double kShift = 1e-5;
constexpr double kLargestShift = 1e-2;   // of a contact's own diagonal, whose unit may be another
constexpr double kSmallestScale = 1e-8;  // of max diag G: keeps r finite for a contact that nothing can move
constexpr double kTouching = 1e-9;       // of the terms: velocity and load of a contact that touches without load
// Share of the error relative to b that counts: a solution is one to 1e-12 of the terms, but to 1e-8 of b at least.
constexpr double kAmplified = 1e-4;

bool covers_rows(const ConeProblem& problem) {
  int row = 0;
  for (const ConeContact& c : problem.contacts) {
    if (c.row != row || (c.rows != 1 && c.rows != 3)) return false;
    if (!std::isfinite(c.mu) || !std::isfinite(c.lower) || c.mu < 0.0 || c.lower < 0.0) return false;
    if (!std::isfinite(c.box) || c.box < 0.0 || (c.box > 0.0 && c.rows != 1)) return false;
    if (c.frozen && !c.d.allFinite()) return false;
    row += c.rows;
  }
  return row == problem.b.size() && problem.G.rows() == row && problem.G.cols() == row;
}

}  // namespace

void NaturalMap::reserve(int rows) {
  if (static_cast<int>(size_.size()) >= rows) return;
  for (auto* v : {&normal_, &tangent_, &shift_, &size_}) v->resize(rows);
  modes_.resize(rows);
}

bool NaturalMap::prepare(const ConeProblem& problem) {
  if (!covers_rows(problem) || !problem.b.allFinite() || !(problem.noise >= 0.0) || !problem.G.allFinite())
    return false;
  const auto& G = problem.G;
  const double largest = G.rows() > 0 ? G.diagonal().cwiseAbs().maxCoeff() : 0.0;
  const double smallest = largest > 0.0 ? kSmallestScale * largest : 1.0;
  energy_ = 0.0;
  const double excused = problem.noise * (kAmplified / kConeTolerance);
  int i = 0;
  for (const ConeContact& c : problem.contacts) {
    const int n = c.row;
    normal_[i] = std::max(std::abs(G(n, n)), smallest);
    double own = std::abs(G(n, n));
    tangent_[i] = normal_[i];
    if (c.rows == 3) {
      const double t1 = std::abs(G(n + 1, n + 1)), t2 = std::abs(G(n + 2, n + 2));
      tangent_[i] = std::max({t1 + std::abs(G(n + 1, n + 2)), t2 + std::abs(G(n + 2, n + 1)), smallest});
      own = std::max({own, t1, t2});
    }
    shift_[i] = own > 0.0 ? std::min(kShift * largest, kLargestShift * own) : kShift * largest;
    const double speed = std::max({std::abs(problem.b[n]), c.lower * normal_[i], excused});
    energy_ = std::max(energy_, speed * speed / normal_[i]);
    if (c.rows == 3) energy_ = std::max(energy_, problem.b.segment<2>(n + 1).squaredNorm() / tangent_[i]);
    ++i;
  }
  return true;
}

namespace {
void add_column(int m, const double* __restrict g, double x, double* __restrict w) {
  for (int k = 0; k < m; ++k) w[k] += g[k] * x;
}

void add_column_and_size(int m, const double* __restrict g, double x, double* __restrict w, double* __restrict size) {
  const double a = std::abs(x);
  for (int k = 0; k < m; ++k) {
    w[k] += g[k] * x;
    size[k] += std::abs(g[k]) * a;
  }
}
}  // namespace

void NaturalMap::velocity(const ConeProblem& problem, const double* lambda, double* w, bool sizes) {
  const int m = static_cast<int>(problem.b.size());
  double* size = size_.data();
  const double excused = problem.noise / kConeTolerance;
  for (int k = 0; k < m; ++k) w[k] = problem.b[k];
  for (int k = 0; k < m && sizes; ++k) size[k] = std::abs(problem.b[k]) + excused;
  for (int j = 0; j < m; ++j) {
    const double x = lambda[j];
    if (x == 0.0) continue;
    const double* g = problem.G.data() + j * problem.G.outerStride();
    if (sizes)
      add_column_and_size(m, g, x, w, size);
    else
      add_column(m, g, x, w);
  }
  if (shift_times_ == 0.0) return;
  int i = 0;
  for (const ConeContact& c : problem.contacts) {
    for (int k = c.row; k < c.row + c.rows; ++k) w[k] += shift(i) * lambda[k];
    ++i;
  }
}

void NaturalMap::evaluate(const ConeProblem& problem, const double* lambda, const double* w) {
  merit_ = residual_ = 0.0;
  touching_ = false;
  int i = 0;
  for (const ConeContact& c : problem.contacts) {
    const int n = c.row;
    ConeMode& mode = modes_[i];
    const double z_n = lambda[n] - w[n] / normal_[i];
    mode.closed = c.box > 0.0 ? !c.frozen && std::abs(z_n) <= c.box : z_n > c.lower;
    mode.bound = c.box > 0.0 ? (c.frozen ? -c.box * c.d[0] : std::copysign(c.box, z_n)) : c.lower;
    const double rho = mode.closed ? z_n : mode.bound;
    const double f_n = mode.closed ? w[n] : (lambda[n] - mode.bound) * normal_[i];  // F_n / r_n without cancellation
    double size = size_[n], worst = std::abs(f_n);
    merit_ += f_n * f_n / normal_[i];
    mode.tangent = TangentMode::kNone;
    if (c.rows == 3) {
      const double scale = tangent_[i], radius = c.mu * rho;
      const Eigen::Vector2d l_t(lambda[n + 1], lambda[n + 2]), w_t(w[n + 1], w[n + 2]);
      Eigen::Vector2d f_t;
      if (!(radius > 0.0)) {
        mode.tangent = TangentMode::kZero;
        f_t = l_t * scale;
      } else if (c.frozen) {
        mode.tangent = TangentMode::kFrozen;
        f_t = (l_t + radius * c.d) * scale;
      } else {
        const Eigen::Vector2d z = l_t - w_t / scale;
        const double length = std::sqrt(z.squaredNorm());
        if (length <= radius) {
          mode.tangent = TangentMode::kStick;
          f_t = w_t;
        } else {
          mode.tangent = TangentMode::kSlip;
          mode.e = z / length;
          mode.beta = radius / length;
          f_t = (l_t - radius * mode.e) * scale;
        }
      }
      merit_ += f_t.squaredNorm() / scale;
      worst = std::max({worst, std::abs(f_t[0]), std::abs(f_t[1])});
      size = std::max({size, size_[n + 1], size_[n + 2]});
    }
    if (c.box == 0.0 && std::max(w[n], (lambda[n] - c.lower) * normal_[i]) <= kTouching * size) touching_ = true;
    if (worst > 0.0) residual_ = std::max(residual_, size > 0.0 ? worst / size : 1.0);
    ++i;
  }
  if (merit_ > 0.0) residual_ = std::max(residual_, energy_ > 0.0 ? kAmplified * std::sqrt(merit_ / energy_) : 1.0);
  // std::max lets a NaN pass; the merit does not.
  if (!std::isfinite(merit_)) residual_ = merit_ = std::numeric_limits<double>::infinity();
}

}  // namespace contactvi

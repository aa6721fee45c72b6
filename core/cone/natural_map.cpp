#include "cone/natural_map.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace contactvi {

namespace {

// Shift as a share of max diag G: a smaller one amplifies rounding, from a larger one the unshifted solution is far.
constexpr double kMapShift = 1e-5;
constexpr double kLargestOwnShift = 1e-2;  // of a contact's own diagonal, whose unit may be another
constexpr double kSmallestScale = 1e-8;    // of max diag G: keeps r finite for a contact that nothing can move
constexpr double kTouching = 1e-9;         // of the terms: velocity and load of a contact that touches without load
// Share of the error relative to b that counts: a solution is one to 1e-12 of the terms, but to 1e-8 of b at least.
constexpr double kAmplified = 1e-4;

bool covers_rows(const ConeProblem& problem) {
  int row = 0;
  for (const ConeContact& c : problem.contacts) {
    if (c.row != row || (c.rows != 1 && c.rows != c.rows_of_friction())) return false;
    if (c.rows > 3 && (!std::isfinite(c.rolling) || (c.frozen_rolling && !c.d_rolling.allFinite()))) return false;
    if (!std::isfinite(c.mu) || !std::isfinite(c.lower) || c.mu < 0.0 || c.lower < 0.0) return false;
    if (!std::isfinite(c.box) || c.box < 0.0 || (c.box > 0.0 && c.rows != 1)) return false;
    if (c.frozen && !(c.d.allFinite() && std::isfinite(c.d_spin))) return false;
    row += c.rows;
  }
  return row == problem.b.size() && problem.G.rows() == row && problem.G.cols() == row;
}

// Bound on the norm of a part of the diagonal of G: its largest sum of a row.
double largest_sum(const Eigen::Ref<const MatX>& G, int first, int count) {
  return G.block(first, first, count, count).cwiseAbs().rowwise().sum().maxCoeff();
}

}  // namespace

void NaturalMap::reserve(int rows) {
  if (static_cast<int>(size_.size()) >= rows) return;
  for (auto* v : {&normal_, &tangent_, &rolling_, &shift_, &size_}) v->resize(rows);
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
    if (c.rows > 1) {
      const double t1 = std::abs(G(n + 1, n + 1)), t2 = std::abs(G(n + 2, n + 2));
      tangent_[i] = std::max({t1 + std::abs(G(n + 1, n + 2)), t2 + std::abs(G(n + 2, n + 1)), smallest});
      own = std::max({own, t1, t2});
    }
    if (c.rows > 3) {
      tangent_[i] = std::max(largest_sum(G, n + 1, c.friction_rows()), smallest);
      if (c.rolling > 0.0) rolling_[i] = std::max(largest_sum(G, n + c.rolling_row(), 2), smallest);
    }
    shift_[i] = own > 0.0 ? std::min(kMapShift * largest, kLargestOwnShift * own) : kMapShift * largest;
    const double speed = std::max({std::abs(problem.b[n]), c.lower * normal_[i], excused});
    energy_ = std::max(energy_, speed * speed / normal_[i]);
    if (c.rows > 1) energy_ = std::max(energy_, problem.b.segment<2>(n + 1).squaredNorm() / tangent_[i]);
    if (c.rows > 3 && c.spins) energy_ = std::max(energy_, problem.b[n + 3] * problem.b[n + 3] / tangent_[i]);
    if (c.rows > 3 && c.rolling > 0.0)
      energy_ = std::max(energy_, problem.b.segment<2>(n + c.rolling_row()).squaredNorm() / rolling_[i]);
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

// The piece of the projection onto a ball of N rows that holds there; adds what F_t is.
template <int N>
[[gnu::always_inline]] inline TangentMode NaturalMap::ball(double radius, double scale, bool frozen, const double* d,
                                                           const double* lambda, const double* w, Vec3& e, double& beta,
                                                           Error& error) {
  using Rows = Eigen::Matrix<double, N, 1>;
  const Eigen::Map<const Rows> l_t(lambda), w_t(w), given(d);
  Rows f_t;  // F_t / r_t
  TangentMode mode = TangentMode::kZero;
  if (!(radius > 0.0)) {
    f_t = l_t * scale;
  } else if (frozen) {
    mode = TangentMode::kFrozen;
    f_t = (l_t + radius * given) * scale;
  } else {
    const Rows z = l_t - w_t / scale;
    const double length = std::sqrt(z.squaredNorm());
    if (length <= radius) {
      mode = TangentMode::kStick;
      f_t = w_t;
    } else {
      mode = TangentMode::kSlip;
      e.setZero();
      e.template head<N>() = z / length;
      beta = radius / length;
      f_t = (l_t - radius * e.template head<N>()) * scale;
    }
  }
  merit_ += f_t.squaredNorm() / scale;
  error.worst = std::max(error.worst, f_t.cwiseAbs().maxCoeff());
  return mode;
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
    Error error{std::abs(f_n), size_[n]};
    merit_ += f_n * f_n / normal_[i];
    mode.tangent = mode.rolling = TangentMode::kNone;
    if (c.rows > 1) {
      const double d[3] = {c.d[0], c.d[1], c.d_spin};
      mode.tangent =
          c.spins ? ball<3>(c.mu * rho, tangent_[i], c.frozen, d, lambda + n + 1, w + n + 1, mode.e, mode.beta, error)
                  : ball<2>(c.mu * rho, tangent_[i], c.frozen, d, lambda + n + 1, w + n + 1, mode.e, mode.beta, error);
      for (int k = n + 1; k <= n + c.friction_rows(); ++k) error.size = std::max(error.size, size_[k]);
    }
    if (c.rows > 3 && c.rolling > 0.0) {
      const int r = n + c.rolling_row();
      Error own{0.0, std::max(size_[r], size_[r + 1])};
      mode.rolling = ball<2>(c.rolling * rho, rolling_[i], c.frozen_rolling, c.d_rolling.data(), lambda + r, w + r,
                             mode.e_rolling, mode.beta_rolling, own);
      if (own.worst > 0.0) residual_ = std::max(residual_, own.size > 0.0 ? own.worst / own.size : 1.0);
    }
    const auto [worst, size] = error;
    if (c.box == 0.0 && std::max(w[n], (lambda[n] - c.lower) * normal_[i]) <= kTouching * size) touching_ = true;
    if (worst > 0.0) residual_ = std::max(residual_, size > 0.0 ? worst / size : 1.0);
    ++i;
  }
  if (merit_ > 0.0) residual_ = std::max(residual_, energy_ > 0.0 ? kAmplified * std::sqrt(merit_ / energy_) : 1.0);
  // std::max lets a NaN pass; the merit does not.
  if (!std::isfinite(merit_)) residual_ = merit_ = std::numeric_limits<double>::infinity();
}

}  // namespace contactvi

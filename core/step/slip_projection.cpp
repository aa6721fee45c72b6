#include "step/slip_projection.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace contactvi {

namespace {
constexpr int kMostIterations = 30;
// Of the speeds: what a change of directions moves that is rounding, and from which on rounding may keep it from
// becoming less.
constexpr double kExact = 1e-16, kNear = 1e-13;
// Of what friction answers to a turn of its direction: a slip below it counts as it. Else rounding would turn contacts
// that share a load against each other, which changes nothing but where all of them come to rest.
constexpr double kStillHeld = 1e-3;
}  // namespace

bool SlipProjection::apply(StepEquations& equations, const MatX& W, const MatX& T, const VecX& rate, const VecX& drift,
                           const std::vector<PhaseRows::Slide>& slides, int first, const VecCRef& coefficients,
                           const VecCRef& before, VecRef p, VecX& v, VecRef lambda, VecRef angles, VecRef slips) {
  const Eigen::Index m = W.cols(), count = static_cast<Eigen::Index>(slides.size()), n = m + count;
  MatX forces(p.size(), m + 2 * count), X(p.size(), m + 2 * count + 1);
  forces << W, T;
  X << forces, p;
  equations.solve_masses(X);
  const MatX to_W = W.transpose() * X, to_T = T.transpose() * X;  // velocities of the rows, and along the tangents
  if (!to_W.allFinite() || !to_T.allFinite()) return false;
  // The momentum is a sum of the columns behind X with these weights; J: their derivatives by lambda and the angles.
  VecX weights = VecX::Zero(X.cols());
  weights[X.cols() - 1] = 1.0;
  MatX J = MatX::Zero(X.cols(), n);
  J.topLeftCorner(m, m).setIdentity();
  const auto weigh = [&] {
    weights.head(m) = lambda;
    for (Eigen::Index j = 0; j < count; ++j) {
      const int normal = slides[static_cast<std::size_t>(j)].normal;
      const double mu = coefficients[j];
      const Eigen::Vector2d d(std::cos(angles[j]), std::sin(angles[j])), across(-d[1], d[0]);
      const double friction = mu * lambda[first + normal];
      weights.segment<2>(m + 2 * j) = -friction * d;
      J.col(first + normal).segment<2>(m + 2 * j) = -mu * d;
      J.col(m + j).segment<2>(m + 2 * j) = -friction * across;
    }
  };
  MatX A(n, n);
  VecX residual(n), scale(n), row_scale(n), now = VecX::Zero(n), change;
  std::vector<char> turned(slides.size(), 0);
  double last = std::numeric_limits<double>::infinity();
  for (int k = 0; k < kMostIterations; ++k) {
    weigh();
    const VecX w = to_W * weights, u = to_T * weights + drift;
    const double speed = 1.0 + w.cwiseAbs().maxCoeff() + u.cwiseAbs().maxCoeff();
    const MatX to_u = to_T * J;
    A.topRows(m).noalias() = to_W * J;
    residual.head(m) = w + rate;
    for (Eigen::Index j = 0; j < count; ++j) {
      const double c = std::cos(angles[j]), s = std::sin(angles[j]);
      A.row(m + j) = c * to_u.row(2 * j + 1) - s * to_u.row(2 * j);
      residual[m + j] = c * u[2 * j + 1] - s * u[2 * j];
      slips[j] = c * u[2 * j] + s * u[2 * j + 1];
      char& back = turned[static_cast<std::size_t>(j)];
      if (slips[j] < kTurned * std::min(0.0, A(m + j, m + j))) back = 1;
      const double still = kStillHeld * std::abs(A(m + j, m + j));
      A(m + j, m + j) -= std::abs(slips[j]) < still ? still : slips[j];
      if (back == 0) continue;
      A.row(m + j).setZero();
      A(m + j, m + j) = 1.0;
      residual[m + j] = angles[j] - before[j];
    }
    // Rows in the scale of their mobility, those of contacts in a common one; directions in that of what they do.
    const double common = m > first ? std::max(0.0, A.diagonal().segment(first, m - first).maxCoeff()) : 0.0;
    for (Eigen::Index r = 0; r < m; ++r) {
      const double mobility = r < first || !(A(r, r) > 0.0) ? A(r, r) : common;
      scale[r] = row_scale[r] = mobility > 0.0 ? 1.0 / std::sqrt(mobility) : 0.0;
    }
    for (Eigen::Index r = m; r < n; ++r) {
      row_scale[r] = common > 0.0 ? 1.0 / std::sqrt(common) : 1.0;
      const double largest = A.col(r).cwiseAbs().maxCoeff();
      scale[r] = largest > 0.0 ? 1.0 / (row_scale[r] * largest) : 0.0;
    }
    system_.set(A, row_scale, scale);
    now.head(m) = lambda;
    system_.solve(residual, now, change);
    if (!change.allFinite()) return false;
    lambda += change.head(m);
    const VecX turns = change.tail(count).cwiseMax(-kFarTurn).cwiseMin(kFarTurn);
    angles += turns;
    // By all turns together: contacts that share a load may turn against each other.
    const double moved = std::max((A.topRightCorner(m, count) * turns).cwiseAbs().maxCoeff(),
                                  (to_u.rightCols(count) * turns).cwiseAbs().maxCoeff());
    const bool settled = k > 0 && (moved <= kExact * speed || (moved <= kNear * speed && moved >= 0.5 * last));
    last = moved;
    if (!settled) continue;
    weigh();
    p += forces * weights.head(forces.cols());
    v = X * weights;
    moved_ = X.leftCols(forces.cols()) * J.topRows(forces.cols());
    conditions_.resize(p.size(), n);
    conditions_.leftCols(m) = W;
    for (Eigen::Index j = 0; j < count; ++j) {
      const double c = std::cos(angles[j]), s = std::sin(angles[j]);
      conditions_.col(m + j) = c * T.col(2 * j + 1) - s * T.col(2 * j);
      if (turned[static_cast<std::size_t>(j)] != 0) conditions_.col(m + j).setZero();
    }
    const VecX slip = T.transpose() * v + drift;
    for (Eigen::Index j = 0; j < count; ++j)
      slips[j] = std::cos(angles[j]) * slip[2 * j] + std::sin(angles[j]) * slip[2 * j + 1];
    return v.allFinite();
  }
  return false;
}

void SlipProjection::respond(StepEquations& equations, MatX& X) const {
  equations.solve_masses(X);
  const VecX none = VecX::Zero(conditions_.cols());
  VecX change;
  for (Eigen::Index k = 0; k < X.cols(); ++k) {
    system_.solve(conditions_.transpose() * X.col(k), none, change);
    X.col(k) += moved_ * change;
  }
}

}  // namespace contactvi

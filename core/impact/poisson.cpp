#include "impact/poisson.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/root.hpp"

namespace contactvi {

namespace {
constexpr double kGain = 1e-12;       // of the energy of the closing motion: a smaller gain is rounding
constexpr double kRounding = 2e-14;   // of the speeds
constexpr double kAccept = 1e-9;      // residual of a cone problem that did not converge
constexpr double kShareWidth = 1e-9;  // of e: accuracy of its largest share without gain
constexpr int kBisections = 50;
}  // namespace

double ClosedGuard::gamma_n(const VecX& p) const {
  double least = std::numeric_limits<double>::infinity();
  for (int i = 0; i < count; ++i) least = std::min(least, gamma_n(i, p));
  return least;
}

bool PoissonImpact::cone(const VecX& start, bool expansion, double share, const std::vector<BlockMember>& members,
                         VecX& lambda) {
  std::size_t k = 0;
  for (const BlockMember& member : members)
    for (int i = 0; i < member.closed->count; ++i, ++k)
      cones_[k].lower = expansion ? share * member.e * std::max(0.0, first_[cones_[k].row]) : 0.0;
  lambda.setZero(G_.rows());
  for (const ConeContact& c : cones_) lambda[c.row] = c.lower;
  const ConeResult result =
      solver_.solve({cones_, G_, start, kRounding * (1.0 + start.cwiseAbs().maxCoeff())}, lambda, true);
  iterations_ += result.iterations;
  // The error of a nearly singular problem is left to a further impact.
  return (result.ok || result.residual <= kAccept) && lambda.allFinite();
}

PoissonResult PoissonImpact::solve(const std::vector<BlockMember>& members, const VecX& p) {
  PoissonResult result;
  int rows = 0;
  cones_.clear();
  bool elastic = false;
  for (const BlockMember& member : members) {
    const ClosedGuard& c = *member.closed;
    elastic |= member.e > 0.0;
    for (int i = 0; i < c.count; ++i) {
      ConeContact cone{};
      cone.row = rows;
      cone.rows = c.rows_per_point();
      cone.mu = c.mu;
      cones_.push_back(cone);
      rows += cone.rows;
    }
  }
  solver_.reserve(rows);
  G_.resize(rows, rows);
  result.gamma_minus.resize(rows);
  int at = 0;
  for (const BlockMember& a : members) {
    const auto Wa = a.closed->W.leftCols(a.closed->rows);
    result.gamma_minus.segment(at, a.closed->rows) = a.closed->speeds(p);
    int from = 0;
    for (const BlockMember& b : members) {
      G_.block(at, from, a.closed->rows, b.closed->rows).noalias() =
          Wa.transpose() * b.closed->MinvW.leftCols(b.closed->rows);
      from += b.closed->rows;
    }
    at += a.closed->rows;
  }
  iterations_ = 0;
  if (!cone(result.gamma_minus, false, 0.0, members, first_)) return result;
  const VecX compressed = result.gamma_minus + G_ * first_;
  VecX second = VecX::Zero(rows);
  auto finish = [&] {
    result.lambda = first_ + second;
    result.gamma_plus = result.gamma_minus + G_ * result.lambda;
    result.loss = -0.5 * result.lambda.dot(result.gamma_minus + result.gamma_plus);
  };
  finish();
  const double scale = std::abs(first_.dot(result.gamma_minus));
  if (elastic) {
    double share = 1.0;
    auto loses = [&](double e, bool& holds) {
      if (!cone(compressed, true, e, members, second)) return false;
      finish();
      holds = !(result.loss < -kGain * scale);
      return true;
    };
    if (!largest_where(kShareWidth, kBisections, loses, share)) return result;
    result.restitution = share;
  }
  result.first = first_;
  result.iterations = iterations_;
  result.ok = result.lambda.allFinite();
  return result;
}

}  // namespace contactvi

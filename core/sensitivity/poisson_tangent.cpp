#include "sensitivity/poisson_tangent.hpp"

#include <algorithm>
#include <cmath>

#include "sensitivity/kinks.hpp"

namespace contactvi {

namespace {
// Of the terms of a speed: what a point on the border may move along a direction.
constexpr double kBorderSpeed = 1e-9;
constexpr double kTiny = 1e-300;
}  // namespace

void PoissonTangent::take(const std::vector<ImpactPoint>& points, const VecX& gamma, const MatX& G, const VecX& first,
                          const VecX& lambda) {
  points_ = points;
  G_ = G;
  margin_ = 1.0;
  speed_ = gamma.cwiseAbs().maxCoeff();
  impulse_ = 0.0;
  bool elastic = false;
  VecX least = VecX::Zero(static_cast<Eigen::Index>(points.size()));
  for (const ImpactPoint& point : points) {
    impulse_ = std::max(impulse_, std::abs(first[point.row]));
    elastic |= point.e > 0.0;
  }
  compression_.any = true;
  compression_.lambda = first;
  compression_.gamma = gamma + G * first;
  set_phase(compression_, least);
  expansion_.any = elastic;
  if (!elastic) return;
  for (std::size_t i = 0; i < points.size(); ++i) least[i] = points[i].e * std::max(0.0, first[points[i].row]);
  expansion_.lambda = lambda - first;
  expansion_.gamma = gamma + G * lambda;
  set_phase(expansion_, least);
}

// What the points do in a problem, and the equations for the changes of the impulses.
void PoissonTangent::set_phase(Phase& phase, const VecX& least) {
  const Eigen::Index rows = G_.rows();
  MatX A = G_;
  phase.modes.clear();
  phase.slips.clear();
  phase.at_least.clear();
  for (std::size_t i = 0; i < points_.size(); ++i) {
    const ImpactPoint& point = points_[i];
    const int r = point.row;
    const double normal = phase.lambda[r];
    // What is so far below the other impulses is rounding, of contacts that do not take part.
    const bool unloaded = phase.lambda.segment(r, point.rows).cwiseAbs().maxCoeff() <= kOnCone * impulse_;
    if (unloaded && least[i] <= kOnCone * impulse_) {
      phase.modes.push_back(std::abs(phase.gamma[r]) <= kOnCone * speed_ ? Mode::kBorder : Mode::kOpen);
      phase.at_least.push_back(0);
      A.middleRows(r, point.rows) = MatX::Identity(rows, rows).middleRows(r, point.rows);
      continue;
    }
    const bool at_least = least[i] > 0.0 && normal <= least[i] * (1.0 + kOnCone);
    phase.at_least.push_back(at_least);
    if (at_least) A.row(r) = MatX::Identity(rows, rows).row(r);
    phase.modes.push_back(Mode::kLoaded);
    for (const FrictionRows& rows_of : friction_rows(r, point.rows)) {
      const int first = rows_of.row, count = rows_of.count;
      const double mu = rows_of.rolls ? 1.0 : point.mu;
      const VecX slip = phase.gamma.segment(first, count);
      const double friction = phase.lambda.segment(first, count).norm(), limit = mu * normal;
      const bool slips = friction >= limit * (1.0 - kOnCone);
      // How far the friction is from its limit where it sticks, and the slip from zero where it slips.
      const double margin = slips ? slip.norm() / (speed_ + kTiny) : (limit - friction) / (impulse_ + kTiny);
      margin_ = std::min(margin_, margin);
      if (!slips || margin < kOnCone) continue;  // without a slip on the border it sticks
      phase.slips.push_back({i, rows_of, mu});
      A.middleRows(first, count) = mu * normal * turn_of(slip) * G_.middleRows(first, count);
      A.block(first, first, count, count).diagonal().array() += 1.0;
      A.block(first, r, count, 1) += mu * slip.normalized();
    }
  }
  phase.system.compute(A);
}

bool PoissonTangent::determines(const MatX& effect) const {
  const double bound = kShared * effect.cwiseAbs().maxCoeff();
  for (const Phase* phase : {&compression_, &expansion_}) {
    if (!phase->any || phase->system.free().cols() == 0) continue;
    if ((effect * phase->system.free()).cwiseAbs().maxCoeff() > bound) return false;
  }
  if (!expansion_.any) return true;
  // What the compression leaves open of its normal impulses, the expansion multiplies by e.
  const MatX& free = compression_.system.free();
  PoissonDirection none;
  none.e = none.mu = VecX::Zero(static_cast<Eigen::Index>(points_.size()));
  none.size = VecX::Zero(G_.rows());
  VecX dleast(none.e.size()), second;
  for (Eigen::Index k = 0; k < free.cols(); ++k) {
    const VecX first = free.col(k);
    for (std::size_t i = 0; i < points_.size(); ++i) dleast[i] = points_[i].e * first[points_[i].row];
    solve(expansion_, G_ * first, dleast, none, second);
    if ((effect * (first + second)).cwiseAbs().maxCoeff() > bound) return false;
  }
  return true;
}

PoissonTangent::Outcome PoissonTangent::solve(const PoissonDirection& d, VecX& dlambda) const {
  const auto count = static_cast<Eigen::Index>(points_.size());
  const Outcome found = solve(compression_, d.gamma + d.G * compression_.lambda, VecX::Zero(count), d, dlambda);
  if (!expansion_.any) return found;
  VecX dleast(count), second;
  for (Eigen::Index i = 0; i < count; ++i) {
    const ImpactPoint& point = points_[i];
    dleast[i] = d.e[i] * compression_.lambda[point.row] + point.e * dlambda[point.row];
  }
  const VecX start = d.gamma + d.G * (compression_.lambda + expansion_.lambda) + G_ * dlambda;
  const Outcome last = solve(expansion_, start, dleast, d, second);
  dlambda += second;
  return found == Outcome::kSolved ? last : found;
}

// dgamma0: the change of the speeds with the impulses of this problem as they are.
PoissonTangent::Outcome PoissonTangent::solve(const Phase& phase, const VecX& dgamma0, const VecX& dleast,
                                              const PoissonDirection& d, VecX& dlambda) const {
  VecX c = dgamma0;
  for (std::size_t i = 0; i < points_.size(); ++i) {
    const ImpactPoint& point = points_[i];
    const int r = point.row;
    if (phase.modes[i] == Mode::kOpen || phase.modes[i] == Mode::kBorder) {
      c.segment(r, point.rows).setZero();
      continue;
    }
    if (phase.at_least[i]) c[r] = -dleast[i];
  }
  for (const Slip& at : phase.slips) {
    const auto& [row, count, rolls] = at.rows;
    const VecX slip = phase.gamma.segment(row, count);
    const double dmu = rolls ? 0.0 : d.mu[static_cast<Eigen::Index>(at.point)];
    c.segment(row, count) = phase.lambda[points_[at.point].row] *
                            (dmu * slip.normalized() + at.mu * turn_of(slip) * dgamma0.segment(row, count));
  }
  if (!phase.system.solve(c, d.size, dlambda)) return Outcome::kContradiction;
  for (std::size_t i = 0; i < points_.size(); ++i) {
    if (phase.modes[i] != Mode::kBorder) continue;
    const int r = points_[i].row;
    const double size = d.size[r] + G_.row(r).cwiseAbs().dot(dlambda.cwiseAbs());
    if (std::abs(dgamma0[r] + G_.row(r).dot(dlambda)) > kBorderSpeed * size) return Outcome::kKink;
  }
  return Outcome::kSolved;
}

}  // namespace contactvi

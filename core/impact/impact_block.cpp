#include "impact/impact_block.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/root.hpp"
#include "impact/incremental_impact.hpp"

namespace contactvi {

namespace {
constexpr double kGain = 1e-12;       // of the energy of the closing motion: a smaller gain is rounding
constexpr double kRounding = 2e-14;   // of the speeds
constexpr double kAccept = 1e-9;      // residual of a cone problem that did not converge
constexpr double kShareWidth = 1e-9;  // of e: accuracy of its largest share without gain
constexpr int kBisections = 50;
constexpr double kWork = 1e-14;      // of the work of the compression: accuracy of what the expansion gives back
constexpr double kMostShare = 64.0;  // of the impulses of the compression, that an expansion may have
constexpr int kEvaluations = 100;
const ContactLaw kPoissonLaw;
}  // namespace

double ClosedGuard::gamma_n(const VecX& p) const {
  double least = std::numeric_limits<double>::infinity();
  for (int i = 0; i < count; ++i) least = std::min(least, gamma_n(i, p));
  return least;
}

bool ImpactBlock::cone(const VecX& start, VecX& lambda) {
  lambda.setZero(G_.rows());
  for (const ConeContact& c : cones_) lambda[c.row] = c.lower;
  const ConeResult result =
      solver_.solve({cones_, G_, start, kRounding * (1.0 + start.cwiseAbs().maxCoeff())}, lambda, true);
  result_.iterations += result.iterations;
  // The error of a nearly singular problem is left to a further impact.
  return (result.ok || result.residual <= kAccept) && lambda.allFinite();
}

void ImpactBlock::set_problem(const std::vector<BlockMember>& members, const VecX& p) {
  int rows = 0;
  cones_.clear();
  for (const BlockMember& member : members) {
    const ClosedGuard& c = *member.closed;
    for (int i = 0; i < c.count; ++i) {
      ConeContact cone{};
      cone.row = rows;
      cone.rows = c.rows_per_point();
      cone.mu = c.friction(i, p);
      cone.spins = cone.rows > 3 && c.spinning > 0.0;
      cone.rolling = cone.rows > 3 && c.rolling > 0.0 ? 1.0 : 0.0;  // its rows are times the radius
      cones_.push_back(cone);
      rows += cone.rows;
    }
  }
  own_ = members.front().closed->count;
  solver_.reserve(rows);
  G_.resize(rows, rows);
  result_.gamma_minus.resize(rows);
  int at = 0;
  for (const BlockMember& a : members) {
    const auto Wa = a.closed->W.leftCols(a.closed->rows);
    result_.gamma_minus.segment(at, a.closed->rows) = a.closed->speeds(p);
    int from = 0;
    for (const BlockMember& b : members) {
      G_.block(at, from, a.closed->rows, b.closed->rows).noalias() =
          Wa.transpose() * b.closed->MinvW.leftCols(b.closed->rows);
      from += b.closed->rows;
    }
    at += a.closed->rows;
  }
}

// Sets the result of the impulses first_ and second_.
void ImpactBlock::finish() {
  result_.lambda = first_ + second_;
  result_.gamma_plus = result_.gamma_minus + G_ * result_.lambda;
  result_.loss = -0.5 * result_.lambda.dot(result_.gamma_minus + result_.gamma_plus);
}

bool ImpactBlock::follow(double e, const ContactLaw& law) {
  const IncrementalImpact impact =
      follow_impact(G_.topLeftCorner<3, 3>(), result_.gamma_minus.head<3>(), cones_.front().mu, e, law.restitution);
  course_ = impact.course;
  if (!impact.ok) return false;
  first_ = impact.compression;
  second_ = impact.lambda - impact.compression;
  return true;
}

// Work of the normal impulses of the first member, which lead on from the speeds `before` [J].
double ImpactBlock::normal_work(const VecX& lambda, const VecX& before) const {
  const VecX change = G_ * lambda;
  double work = 0.0;
  for (int i = 0; i < own_; ++i) {
    const int r = cones_[static_cast<std::size_t>(i)].row;
    work += lambda[r] * (before[r] + 0.5 * change[r]);
  }
  return work;
}

// Expansion after the compression first_, to second_.
bool ImpactBlock::expand(double e, double tangential) {
  speeds_ = result_.gamma_minus;
  const bool both = tangential > 0.0;  // the problem is one for the impulses of both phases
  if (!both) speeds_ += G_ * first_;
  for (int i = 0; i < own_; ++i) {
    ConeContact& c = cones_[static_cast<std::size_t>(i)];
    c.lower = (both ? 1.0 + e : e) * std::max(0.0, first_[c.row]);
    if (c.rows == 3) speeds_.segment<2>(c.row + 1) += tangential * result_.gamma_minus.segment<2>(c.row + 1);
  }
  const bool solved = cone(speeds_, second_);
  note_course(second_, true);
  for (int i = 0; i < own_; ++i) cones_[static_cast<std::size_t>(i)].lower = 0.0;
  if (both) second_ -= first_;
  return solved;
}

bool ImpactBlock::expand_by_energy(double e, double tangential) {
  const double asked = -e * e * normal_work(first_, result_.gamma_minus);
  const VecX compressed = result_.gamma_minus + G_ * first_;
  // What is missing of the work; it falls with the share of the impulses of the compression.
  const auto missing = [&](double share, double& work) {
    if (!expand(share, tangential)) return false;
    work = asked - normal_work(second_, compressed);
    return true;
  };
  double share = 1.0, work = 0.0;
  while (true) {
    if (!missing(share, work)) return false;
    if (work <= 0.0 || share >= kMostShare) break;
    share *= 2.0;
  }
  if (work >= 0.0) return true;
  return root_by_value(asked, share, work, kWork * asked, 0.0, kEvaluations, missing, share);
}

// The impulses by one coefficient of restitution of the first member, normal and tangential.
bool ImpactBlock::impulses(double e, double tangential, const ContactLaw& law) {
  const bool single = cones_.size() == 1 && cones_.front().rows == 3;
  if (single && (law.incremental || law.restitution == RestitutionLaw::kEnergetic)) return follow(e, law);
  second_.setZero(G_.rows());
  if (law.restitution == RestitutionLaw::kNewton) {
    speeds_ = result_.gamma_minus;
    for (int i = 0; i < own_; ++i) {
      const ConeContact& c = cones_[static_cast<std::size_t>(i)];
      speeds_[c.row] += e * std::min(0.0, result_.gamma_minus[c.row]);
      if (c.rows == 3) speeds_.segment<2>(c.row + 1) *= 1.0 + tangential;
    }
    if (!cone(speeds_, first_)) return false;
    note_course(first_, false);
    return true;
  }
  if (!compressed_ && !cone(result_.gamma_minus, first_)) return false;
  note_course(first_, false);
  compressed_ = true;
  if (!(e > 0.0)) return true;
  return law.restitution == RestitutionLaw::kEnergetic ? expand_by_energy(e, tangential) : expand(e, tangential);
}

// Whether each point is open, sticks or slips in a problem with these impulses; again: of the second problem.
void ImpactBlock::note_course(const VecX& impulses, bool again) {
  course_.resize(again ? cones_.size() : 0);
  for (const ConeContact& c : cones_) {
    const double normal = impulses[c.row];
    char mode = normal <= c.lower + kAccept * impulses.cwiseAbs().maxCoeff() ? 0 : 1;
    if (c.rows > 1 && impulses.segment(c.row + 1, c.friction_rows()).norm() >= c.mu * normal * (1.0 - kAccept))
      mode += 2;
    if (c.rolling > 0.0 && impulses.segment<2>(c.row + c.rolling_row()).norm() >= normal * (1.0 - kAccept)) mode += 4;
    course_.push_back(mode);
  }
}

const ImpactBlockResult& ImpactBlock::solve_again(const VecX& gamma, const MatX& G, double e, const VecX& mu,
                                                  const ContactLaw* given) {
  const ContactLaw& law = given != nullptr ? *given : kPoissonLaw;
  result_.gamma_minus = gamma;
  G_ = G;
  for (std::size_t i = 0; i < cones_.size(); ++i) cones_[i].mu = mu[static_cast<Eigen::Index>(i)];
  compressed_ = false;
  result_.ok = impulses(e, law.tangential, law);
  finish();
  return result_;
}

ImpactBlockResult ImpactBlock::solve(const std::vector<BlockMember>& members, const VecX& p, const ContactLaw* given) {
  const ContactLaw& law = given != nullptr ? *given : kPoissonLaw;
  result_ = ImpactBlockResult();
  set_problem(members, p);
  compressed_ = false;
  const double e = members.front().e;
  double scale = 0.0, share = 1.0;
  const auto loses = [&](double part, bool& holds) {
    if (!impulses(part * e, part * law.tangential, law)) return false;
    finish();
    scale = std::abs(first_.dot(result_.gamma_minus));
    const bool gains = e > 0.0 && -result_.loss > kGain * scale;
    if (part == 1.0) result_.gain = gains ? -result_.loss : 0.0;
    holds = !gains || !law.keeps_energy;
    return true;
  };
  if (!largest_where(kShareWidth, kBisections, loses, share)) return result_;
  result_.restitution = share;
  result_.first = first_;
  result_.ok = result_.lambda.allFinite();
  return result_;
}

}  // namespace contactvi

#include "model/constraint_check.hpp"

#include <algorithm>
#include <cmath>

#include "model/moving_frame.hpp"

namespace contactvi {

namespace {
constexpr double kJump = 4.0;           // of the mean size of a motion's rates in a step: a larger deviation is a jump,
constexpr double kJumpRounding = 1e-9;  // where it is also beyond this [rad; m], [rad/s; m/s]
constexpr double kFar = 1e-4;           // of the configuration: coordinates beyond its inverse have more rounding
constexpr double kMet = 1e-10;          // [m; rad] to which a constraint is satisfied,
constexpr double kMetRate = 1e-7;       // of the speeds: to which its rate is
}  // namespace

double constraint_reach(const VecX& q) { return std::max(1.0, kFar * q.cwiseAbs().maxCoeff()); }

int find_violated(const Elements& elements, const ConstraintErrors& e) {
  double worst = 1.0;
  int violated = -1;
  for (std::size_t i = 0; i < elements.constraints.size(); ++i) {
    const Constraint& c = elements.constraints[i];
    for (int k = c.row; k < c.row + c.rows; ++k) {
      const double place = std::abs(e.end[k]) - e.remaining * std::abs(e.start[k]);
      const double off = std::max(place / (kMet * e.reach), std::abs(e.rates[k]) / (kMetRate * e.speed));
      if (off <= worst) continue;
      worst = off;
      violated = static_cast<int>(i);
    }
  }
  return violated;
}

int find_jump(const Elements& elements, const VecX& moved, const VecX& rate0, const VecX& rate1, double h) {
  MatX rates(rate0.size(), 2);
  rates << rate0, rate1;
  return find_jump(elements, moved, rates, VecX::Constant(2, 0.5), h);
}

int find_jump(const Elements& elements, const VecX& moved, const MatX& rates, const VecX& weights, double h) {
  const auto jumps = [&](int first, int count) {
    const auto told = rates.middleRows(first, count);
    const double size = told.colwise().norm().dot(weights), most = kJump * size + kJumpRounding * (1.0 + 1.0 / h);
    return (moved.segment(first, count) + told * weights).norm() > most;
  };
  for (std::size_t i = 0; i < elements.constraints.size(); ++i) {
    const Constraint& c = elements.constraints[i];
    const bool joint = c.kind == ConstraintKind::kPrescribed && jumps(c.row, 1);
    const bool frame = moving_frame(c) && (jumps(c.row, 3) || jumps(c.row + 3, 3));
    if (joint || frame) return static_cast<int>(i);
  }
  return -1;
}

}  // namespace contactvi

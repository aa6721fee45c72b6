#include "cone/block_newton.hpp"

#include <cmath>

namespace contactvi {

namespace {

// Shift of the natural map's derivative: redundant contacts have no unique impulses, and each step comes nearer by this
// factor at best. Smaller ones lose digits to rounding.
constexpr double kShift = 1e-7;
constexpr int kStepHalvings = 5;    // of a step
constexpr double kDecrease = 1e-3;  // share of the expected decrease that is asked for
constexpr double kShortStep = 0.1;  // below: the linearisation says too little to go on

}  // namespace

double BlockNewton::merit(const BlockSystem& system, const ConePoint& point) const {
  double sum = 0.0;
  for (int c = 0; c < system.contacts(); ++c)
    if (is_alone(system.contact(c)))
      sum += law_merit(system.contact(c), system.matrix(c).largest, point.lambda[c], system.velocity(c, point.v));
  for (std::size_t k = 0; k < system.turning_points().size(); ++k) {
    const int c = system.turning_points()[k];
    const TurningMatrix& m = system.turning_matrix(k);
    sum += turning_merit(
        m, turning_map(system.contact(c), m, system.turning_impulse(c, point), system.turning_velocity(c, point.v)));
  }
  return std::sqrt(sum);
}

// The linearisation of the k-th point with turning friction.
void BlockNewton::add_turning(const BlockSystem& system, std::size_t k) {
  const int c = system.turning_points()[k], turning = system.contact(c).turning;
  const TurningTangent t =
      turning_tangent(system.contact(c), system.turning_matrix(k), system.turning_impulse(c, point_),
                      system.turning_velocity(c, point_.v), kShift);
  K_[c] = t.K.topLeftCorner<3, 3>();
  K_[turning] = t.K.bottomRightCorner<3, 3>();
  crosses_.push_back({c, turning, t.K.topRightCorner<3, 3>()});
  crosses_.push_back({turning, c, t.K.bottomLeftCorner<3, 3>()});
  change_[c] = t.start.head<3>();
  change_[turning] = t.start.tail<3>();
  system.pull(c, change_[c], velocity_);
  system.pull(turning, change_[turning], velocity_);
}

// One step of point_; its length, 0 where none lowers the merit.
double BlockNewton::step(const BlockSystem& system, BlockFactor& factor) {
  const int m = system.contacts();
  velocity_.setZero(system.dofs());
  crosses_.clear();
  for (int c = 0; c < m; ++c) {
    if (!is_alone(system.contact(c))) continue;
    const LawTangent t = law_tangent(system.contact(c), system.matrix(c).largest, point_.lambda[c],
                                     system.velocity(c, point_.v), kShift);
    K_[c] = t.K;
    change_[c] = t.start;
    system.pull(c, t.start, velocity_);
  }
  for (std::size_t k = 0; k < system.turning_points().size(); ++k) add_turning(system, k);
  if (!factor.factor(system.problem(), K_, false, crosses_) || !factor.solve(velocity_)) return 0.0;
  for (int c = 0; c < m; ++c) change_[c].noalias() -= K_[c] * system.speed(c, velocity_);
  for (const CrossWeight& x : crosses_) change_[x.left].noalias() -= x.K * system.speed(x.right, velocity_);
  const double before = merit(system, point_);
  double length = 1.0;
  for (int k = 0; k <= kStepHalvings; ++k, length *= 0.5) {
    for (int c = 0; c < m; ++c) trial_.lambda[c] = point_.lambda[c] + length * change_[c];
    system.update(trial_);
    if (merit(system, trial_) < (1.0 - kDecrease * length) * before) {
      std::swap(point_, trial_);
      return length;
    }
  }
  return 0.0;
}

int BlockNewton::run(const BlockSystem& system, BlockFactor& factor, int steps, double tolerance, ConePoint& best) {
  const std::size_t m = static_cast<std::size_t>(system.contacts());
  K_.resize(m);
  change_.resize(m);
  trial_.lambda.resize(m);
  point_ = best;
  int used = 0;
  while (used < steps && best.residual > tolerance) {
    ++used;
    const double length = step(system, factor);
    if (length == 0.0) break;
    projected_.lambda = point_.lambda;
    system.project(projected_);
    projected_.residual = system.residual(projected_);
    if (projected_.residual < best.residual) best = projected_;
    if (length < kShortStep) break;
  }
  return used;
}

}  // namespace contactvi

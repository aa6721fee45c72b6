#include "step/stage_iteration.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {
constexpr double kRefactor = 3e-3;  // relative error above which the factor is made again
// Errors below which iterations without progress have met rounding: after two of them, and after four.
constexpr double kStagnantSoon = 2e-13, kStagnantLate = 1e-11;
constexpr double kProgress = 0.7;          // ratio of errors that counts as progress of an iteration
constexpr int kMostStagnant = 8;           // iterations without progress after which the start values are given up
constexpr double kBestContraction = 1e-2;  // no better contraction is believed
// Contraction from which on the Newton matrix pays, and stages up to which it does: measured on chains of 10 to 100
// links and the Allegro hand, it saves iterations with 4 stages and more too, but not time (benchmarks/README.md).
constexpr double kSlow = 0.3;
constexpr int kNewtonStages = 3;
constexpr double kVerySlow = 0.5;           // contraction from which on acceleration pays,
constexpr double kAccelerationError = 0.3;  // where the error is below this
constexpr double kFarEnergy = 30.0;         // growth of the energy over a solve: the solution found is not the motion

double relative_error(const Stages& stages) {
  double worst = 0.0;
  for (int i = 0; i < stages.count(); ++i) {
    const double error = std::abs(stages.error(i));
    const double scale = std::max({std::abs(stages.kinetic(i)), stages.impulse_energy(i), error});
    const double relative = error > 0.0 ? error / scale : error;
    if (std::isnan(relative)) return relative;
    worst = std::max(worst, relative);
  }
  return std::sqrt(worst);
}

// Largest energy of a stage: of its motion, or of the impulses that its forces give one by one.
double largest_energy(const Stages& stages) {
  double largest = 0.0;
  for (int i = 0; i < stages.count(); ++i)
    largest = std::max({largest, std::abs(stages.kinetic(i)), stages.impulse_energy(i)});
  return largest;
}
}  // namespace

void StageIteration::begin(bool newton) {
  const double tol = tol_;
  *this = StageIteration(tol, most_);
  newton_ = newton;
  outcome_ = most_ > 0 ? Outcome::kGoesOn : Outcome::kDiverged;
}

int StageIteration::flags() const {
  return (factor_ ? kLaneFactor : 0) | (count_ == 0 ? kLaneFirst : 0) | (newton_ ? kLaneNewton : 0);
}

// Whether the iteration that left this error, theta times the one before, was the last that the step needs.
bool StageIteration::is_converged(double error) const {
  if (error <= tol_) return true;
  // One ratio of errors may be too good by chance, and after an acceleration it tells hardly anything.
  const double believed = std::max(theta_, accelerated_ ? 0.5 : kBestContraction);
  return theta_ >= 0.0 && theta_ < 1.0 && error * believed / (1.0 - believed) <= tol_;
}

StageIteration::Outcome StageIteration::outcome(double error, double energy) {
  if (!std::isfinite(error)) return Outcome::kNotFinite;
  theta_ = previous_ > 0.0 ? error / previous_ : -1.0;
  error_ = error;
  if (count_ == 0) first_energy_ = energy;
  // The equations of long steps have solutions far from the motion too: the iterations are on their way to one.
  if (energy > kFarEnergy * first_energy_) return Outcome::kDiverged;
  if (is_converged(error)) return Outcome::kConverged;
  stagnant_ = error < kProgress * best_ ? 0 : stagnant_ + 1;
  best_ = std::min(best_, error);
  // Near the solution, iterations that gain nothing any more have met rounding; further off they lead nowhere.
  if ((stagnant_ >= 2 && error < kStagnantSoon) || (stagnant_ >= 4 && error < kStagnantLate && !accelerated_))
    return Outcome::kRounding;
  if (stagnant_ >= (accelerated_ ? 2 * kMostStagnant : kMostStagnant)) return Outcome::kDiverged;
  return count_ + 1 < most_ ? Outcome::kGoesOn : Outcome::kDiverged;
}

void StageIteration::judge(const Stages& stages) {
  const double error = relative_error(stages);
  outcome_ = outcome(error, largest_energy(stages));
  forgets_ = accelerates_ = false;
  if (!goes_on()) return;
  const bool slow = count_ >= 2 && theta_ > kSlow, turn = slow && !newton_ && stages.count() <= kNewtonStages;
  forgets_ = factor_ && accelerated_;  // its residuals belong to another matrix
  newton_ = newton_ || turn;
  factor_ = turn || (error > kRefactor && !accelerated_);
  accelerates_ = (slow && theta_ > kVerySlow && !turn && error < kAccelerationError) || accelerated_;
  accelerated_ = accelerated_ || accelerates_;
  previous_ = error;
  ++count_;
}

}  // namespace contactvi

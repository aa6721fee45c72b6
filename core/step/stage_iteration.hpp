// Decides after each iteration on the stage equations of a step whether they are solved and, if not, what the next
// iteration does. It knows the numbers that an iteration leaves per stage, not who made the iteration.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "step/stages.hpp"

namespace contactvi {

class StageIteration {
 public:
  // tol: relative error of the stage velocities, in the energy norm; at most so many iterations.
  StageIteration(double tol, int most) : tol_(tol), most_(most) {}

  double tol() const { return tol_; }
  void set_tol(double tol) { tol_ = tol; }

  // Before the first iteration from some start values; newton: it is one with the Newton matrix; factored: it is one
  // with the matrix as it is.
  void begin(bool newton, bool factored = false);
  bool goes_on() const { return outcome_ == Outcome::kGoesOn; }
  int flags() const;  // of the next iteration (LaneFlags)
  // After an iteration, whose numbers are in stages. constrained: of a step with constraints, whose
  // residuals have rounding of this energy [J]; its matrix and its acceleration are its own then.
  void judge(const Stages& stages);
  void judge(const Stages& stages, double rounding);
  // As this, where there is one stage: its relative error, and its energy.
  void judge(double error, double energy) { judge(error, energy, true); }
  // Of a stage with these numbers (Stages): the square of its relative error, and the energy of its motion or of the
  // impulses that its forces give one by one.
  static double squared_error(double error, double kinetic, double impulse_energy) {
    const double size = std::abs(error), scale = std::max(largest_energy(kinetic, impulse_energy), size);
    return size > 0.0 ? size / scale : size;
  }
  static double largest_energy(double kinetic, double impulse_energy) {
    return std::max(std::abs(kinetic), impulse_energy);
  }
  // Before the next iteration: whether what an acceleration knows belongs to another matrix, and whether the velocities
  // are to be accelerated.
  bool forgets_acceleration() const { return forgets_; }
  bool accelerates() const { return accelerates_; }

  static constexpr double kProgress = 0.7;  // ratio of errors that counts as progress of an iteration

  // Of iterations that have ended. Where the contraction was measured, newton() is the matrix for the next step.
  bool solved() const { return outcome_ == Outcome::kConverged || outcome_ == Outcome::kRounding; }
  bool converged() const { return outcome_ == Outcome::kConverged; }
  bool finite() const { return outcome_ != Outcome::kNotFinite; }
  bool newton() const { return newton_; }
  double error() const { return error_; }        // the last one, relative
  double contraction() const { return theta_; }  // of the last iteration; -1: unknown

 private:
  enum class Outcome { kGoesOn, kConverged, kRounding, kDiverged, kNotFinite };
  static constexpr double kRefactor = 3e-3;  // relative error above which the factor is made again
  // Errors below which iterations without progress have met rounding: after two of them, and after four.
  static constexpr double kStagnantSoon = 2e-13, kStagnantLate = 1e-11;
  static constexpr int kMostStagnant = 8;  // iterations without progress after which the start values are given up
  static constexpr double kBestContraction = 1e-2;  // no better contraction is believed
  // Contraction from which on the Newton matrix pays, and stages up to which it does: measured on chains of 10 to 100
  // links and the Allegro hand, it saves iterations with 4 stages and more too, but not time (benchmarks/README.md).
  static constexpr double kSlow = 0.3;
  static constexpr int kNewtonStages = 3;
  // Of steps that keep rows: contraction from which on the matrix is made anew, unless it is new, or the error is above
  // the other number.
  static constexpr double kPoor = 0.3, kFar = 1e-2;
  static constexpr double kVerySlow = 0.5;           // contraction from which on acceleration pays,
  static constexpr double kAccelerationError = 0.3;  // where the error is below this
  static constexpr double kFarEnergy = 30.0;  // growth of the energy over a solve: the solution found is not the motion
  void judge(double error, double energy, bool few_stages);
  Outcome outcome(double error, double energy);
  bool needs_matrix(double error);
  bool is_converged(double error) const;

  double tol_;
  int most_;
  Outcome outcome_ = Outcome::kDiverged;
  int count_ = 0, stagnant_ = 0;  // iterations, those without progress
  double previous_ = -1.0, before_ = -1.0, theta_ = -1.0, best_ = std::numeric_limits<double>::infinity();
  double error_ = 0.0, first_energy_ = 0.0;
  double floor_ = 0.0;  // relative error that rounding of constraints makes; 0: there are none
  bool newton_ = false, factor_ = true, accelerated_ = false;
  bool forgets_ = false, accelerates_ = false;
};

inline void StageIteration::begin(bool newton, bool factored) {
  const double tol = tol_;
  *this = StageIteration(tol, most_);
  newton_ = newton;
  factor_ = !factored;
  outcome_ = most_ > 0 ? Outcome::kGoesOn : Outcome::kDiverged;
}

inline int StageIteration::flags() const {
  return (factor_ ? kLaneFactor : 0) | (count_ == 0 ? kLaneFirst : 0) | (newton_ ? kLaneNewton : 0);
}

// Whether the iteration that left this error, theta times the one before, was the last that the step needs.
inline bool StageIteration::is_converged(double error) const {
  if (error <= tol_) return true;
  if (!(theta_ >= 0.0 && theta_ < 1.0)) return false;
  // One ratio of errors may be too good by chance, and after an acceleration it tells hardly anything.
  const double believed = std::max(theta_, accelerated_ ? 0.5 : floor_ > 0.0 ? 0.1 : kBestContraction);
  return error * believed <= tol_ * (1.0 - believed);
}

inline StageIteration::Outcome StageIteration::outcome(double error, double energy) {
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
  if (stagnant_ >= 2 && error < (floor_ > 0.0 ? std::max(kStagnantLate, floor_) : kStagnantSoon))
    return Outcome::kRounding;
  if (stagnant_ >= 4 && error < kStagnantLate && !accelerated_) return Outcome::kRounding;
  if (stagnant_ >= (accelerated_ ? 2 * kMostStagnant : kMostStagnant)) return Outcome::kDiverged;
  return count_ + 1 < most_ ? Outcome::kGoesOn : Outcome::kDiverged;
}

// Of a step that keeps rows, before its last error is replaced by this one. A correction of the impulses alone shows in
// the velocities one iteration later.
inline bool StageIteration::needs_matrix(double error) {
  const bool slower = theta_ > kPoor && !(count_ >= 2 && error < kPoor * kPoor * before_);
  before_ = previous_;
  return error > kStagnantLate && (count_ == 0 || factor_ ? error > kFar : slower);
}

inline void StageIteration::judge(double error, double energy, bool few_stages) {
  outcome_ = outcome(error, energy);
  forgets_ = accelerates_ = false;
  if (!goes_on()) return;
  const bool constrained = floor_ > 0.0;
  const bool slow = count_ >= 2 && theta_ > kSlow && !constrained, turn = slow && !newton_ && few_stages;
  forgets_ = factor_ && accelerated_;  // its residuals belong to another matrix
  newton_ = newton_ || turn;
  factor_ = constrained ? needs_matrix(error) : turn || (error > kRefactor && !accelerated_);
  accelerates_ = (slow && theta_ > kVerySlow && !turn && error < kAccelerationError) || accelerated_;
  accelerated_ = accelerated_ || accelerates_;
  previous_ = error;
  ++count_;
}

}  // namespace contactvi

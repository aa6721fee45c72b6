// Decides after each iteration on the stage equations of a step whether they are solved and, if not, what the next
// iteration does. It knows the numbers that an iteration leaves per stage, not who made the iteration.
#pragma once

#include <limits>

#include "step/stages.hpp"

namespace contactvi {

class StageIteration {
 public:
  // tol: relative error of the stage velocities, in the energy norm; at most so many iterations.
  StageIteration(double tol, int most) : tol_(tol), most_(most) {}

  double tol() const { return tol_; }
  void set_tol(double tol) { tol_ = tol; }

  // Before the first iteration from some start values; newton: it is one with the Newton matrix.
  void begin(bool newton);
  bool goes_on() const { return outcome_ == Outcome::kGoesOn; }
  int flags() const;  // of the next iteration (LaneFlags)
  // After an iteration, whose numbers are in stages.
  void judge(const Stages& stages);
  // Before the next iteration: whether what an acceleration knows belongs to another matrix, and whether the velocities
  // are to be accelerated.
  bool forgets_acceleration() const { return forgets_; }
  bool accelerates() const { return accelerates_; }

  // Of iterations that have ended. Where the contraction was measured, newton() is the matrix for the next step.
  bool solved() const { return outcome_ == Outcome::kConverged || outcome_ == Outcome::kRounding; }
  bool converged() const { return outcome_ == Outcome::kConverged; }
  bool finite() const { return outcome_ != Outcome::kNotFinite; }
  bool newton() const { return newton_; }
  double error() const { return error_; }  // the last one, relative

 private:
  enum class Outcome { kGoesOn, kConverged, kRounding, kDiverged, kNotFinite };
  Outcome outcome(double error, double energy);
  bool is_converged(double error) const;
  void choose_next(double error);

  double tol_;
  int most_;
  Outcome outcome_ = Outcome::kDiverged;
  int count_ = 0, stagnant_ = 0;  // iterations, those without progress
  double previous_ = -1.0, theta_ = -1.0, best_ = std::numeric_limits<double>::infinity();
  double error_ = 0.0, first_energy_ = 0.0;
  bool newton_ = false, factor_ = true, accelerated_ = false;
  bool forgets_ = false, accelerates_ = false;
};

}  // namespace contactvi

// Natural map of the cone problem (Alart and Curnier, "A mixed formulation for frictional contact problems prone to
// Newton like solution methods", 1991), its modes and its size:
//
//   F_n = lambda_n - rho,             rho = max(lower, lambda_n - r_n w_n)
//   F_t = lambda_t - P(lambda_t - r_t w_t),   P: projection onto the disc of radius mu rho
//   F_t = lambda_t + mu rho d                 frozen
//
// and likewise for rolling. With a row of spinning F_t has three components, and P is the projection onto a ball.
// F = 0 is the law, for any positive r; here 1/r is the contact's own diagonal of G, so that F/r is a velocity.
#pragma once

#include <vector>

#include "cone/problem.hpp"

namespace contactvi {

enum class TangentMode { kNone, kZero, kStick, kSlip, kFrozen };

// Mode of a contact at some (lambda, w): which piece of the natural map holds there.
struct ConeMode {
  bool closed = false;  // normal: the equation is w_n = 0, else lambda_n = bound
  double bound = 0.0;   // lower, or an end of the box
  TangentMode tangent = TangentMode::kNone;
  Vec3 e = Vec3::Zero();  // slip: unit vector along lambda_t - r_t w_t; third: spinning
  double beta = 1.0;      // slip: mu rho / |lambda_t - r_t w_t|
  TangentMode rolling = TangentMode::kNone;
  Vec3 e_rolling = Vec3::Zero();
  double beta_rolling = 1.0;
};

class NaturalMap {
 public:
  void reserve(int rows);
  // Computes the scales of a problem; false if its numbers are not finite or its contacts do not cover its rows.
  bool prepare(const ConeProblem& problem);
  // Replaces G by G + times eps I, eps = 1e-5 max diag G (at most a hundredth of a contact's own diagonal).
  void set_shift(double times) { shift_times_ = times; }
  double shift_times() const { return shift_times_; }
  double shift(int contact) const { return shift_times_ * shift_[contact]; }

  // w = b + (G + shift) lambda and, with sizes, the size of the terms in each row, to which the residual is relative.
  void velocity(const ConeProblem& problem, const double* lambda, double* w, bool sizes = true);
  // Computes the modes, merit() and residual() at (lambda, w).
  void evaluate(const ConeProblem& problem, const double* lambda, const double* w);

  const ConeMode& mode(int contact) const { return modes_[contact]; }
  double normal_scale(int contact) const { return normal_[contact]; }
  double tangent_scale(int contact) const { return tangent_[contact]; }
  double rolling_scale(int contact) const { return rolling_[contact]; }
  // Sum of F_n^2/r_n + |F_t|^2/r_t [J].
  double merit() const { return merit_; }
  // Largest |F/r| of a contact over the size of the terms it is the sum of, the relative backward error; at least 1e-4
  // of the root of merit over the largest b^2 r [J], since with huge impulses any error is small beside the terms.
  double residual() const { return residual_; }
  // Whether some contact touches without load (w_n = 0 and lambda_n = lower, to 1e-9): impulses may not be unique.
  bool touching() const { return touching_; }

 private:
  struct Error {  // of one contact
    double worst, size;
  };
  template <int N>
  TangentMode ball(double radius, double scale, bool frozen, const double* d, const double* lambda, const double* w,
                   Vec3& e, double& beta, Error& error);

  std::vector<double> normal_, tangent_, rolling_, shift_;  // 1/r_n, 1/r_t, that of rolling, eps per contact
  std::vector<double> size_;                                // per row
  std::vector<ConeMode> modes_;
  double energy_ = 0.0, merit_ = 0.0, residual_ = 0.0;
  double shift_times_ = 0.0;
  bool touching_ = false;
};

}  // namespace contactvi

// One smooth midpoint step: solve p0 = p0(v) for v, then q1 and p1. Quasi-Newton with a factorisation that is kept over
// steps for as long as it contracts.
#pragma once

#include "discrete_lagrangian.hpp"

namespace contactvi {

struct StepCounters {
  long steps = 0, residuals = 0, factorizations = 0;
};

class Integrator {
 public:
  // tol: residual relative to momentum, both in the kinetic-energy norm sqrt(r^T M^-1 r).
  Integrator(const Tree& tree, double tol, int max_iterations);

  // Solve for a step h from (q0, p0). guess: start for v, shape (nv,). False when it does not converge; why() says it.
  bool solve(const VecCRef& q0, const VecCRef& p0, const VecX& guess, double h, const VecX& tau);
  const VecX& v() const { return v_; }
  double residual_norm() const { return residual_norm_; }
  int iterations() const { return iterations_; }
  const char* why() const { return why_; }
  // End state of the step just solved.
  void finish(const VecCRef& q0, const VecCRef& p0, double h, VecRef q1, VecRef p1);

  // v = M(q)^-1 p; leaves M factored in mass() and the kernel placed at q. False if M is not positive.
  bool node_velocity(const VecCRef& q, const VecCRef& p, VecRef v);
  const TreeLu& mass() const { return mass_; }

  const Tree& tree() const { return *tree_; }
  StepWorkspace& workspace() { return ws_; }
  StepCounters counters;

 private:
  bool refresh(double h);
  bool refresh_pays(double rate, double digits) const;
  // Newton with the exact matrix, by differences, and a line search: slow, for steps that the quick way cannot take.
  bool solve_carefully(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau);
  // Norms of the residual just evaluated; false if they are not finite.
  bool measure(const TreeLu& matrix, double h, double& error2, double& scale2);

  const Tree* tree_;
  double tol_;
  int max_iterations_;
  StepWorkspace ws_;
  TreeLu matrix_, mass_;
  double matrix_h_ = -1.0;     // step that matrix_ was factored for, < 0: none
  double fresh_rate_ = 1e-3;   // contraction seen just after a factorisation
  double refresh_cost_ = 1.0;  // of a factorisation, in iterations
  VecX v_, dv_;
  double residual_norm_ = 0.0;
  int iterations_ = 0;
  const char* why_ = "";
};

// Start values for v: polynomial through the last steps of equal length, reset by anything that breaks smoothness.
class Extrapolation {
 public:
  explicit Extrapolation(int nv);
  void reset() { count_ = 0; }
  void push(const VecX& v, double h);
  int count(double h) const { return h == h_ ? count_ : 0; }
  const VecX& last() const { return history_[0]; }
  const VecX& before_last() const { return history_[1]; }
  void guess(VecX& v) const;  // needs count >= 1

 private:
  static constexpr int kDepth = 4;
  VecX history_[kDepth];
  int count_ = 0;
  double h_ = 0.0;
};

}  // namespace contactvi

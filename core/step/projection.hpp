// Impulses on a system with constraints, with the impulses of the constraints that they entail.
//
// An impulse along a row W comes with those of the constraints that keep d phi/dt: p+ = p + (W - Phi mu) lambda with
// mu = (Phi^T M^-1 Phi)^+ Phi^T M^-1 W. So the projected row takes W's place, and its Delassus matrix is that of the
// constrained system. Where a constraint depends on time the row's velocity has a part of its own: offset = -mu . rate.
#pragma once

#include "base/reduction.hpp"
#include "model/constraints.hpp"
#include "step/step_equations.hpp"

namespace contactvi {

// Closes the rates of constraints with gradients W (nv, m): finds the impulses mu (m,) with
// W^T M^-1 (p + W mu) + rate = 0, adds them to p, and sets v = M^-1 p. The node of `equations` must be placed there.
void close_rates(StepEquations& equations, Reduction& reduction, const MatX& W, const VecX& rate, VecRef p, VecX& v,
                 VecRef mu);

class Projection {
 public:
  explicit Projection(const Tree& tree);
  bool any() const { return rows_ > 0; }
  // The constraints at q and t; the node of `equations` must be placed there.
  void set(StepEquations& equations, const Placements& at, const VecCRef& q, double t);
  // Projects the rows W (nv, k) and M^-1 W; fills mu (rows, k) and offset (k,).
  void apply(Eigen::Ref<MatX> W, Eigen::Ref<MatX> MinvW, Eigen::Ref<MatX> mu, VecRef offset);
  const VecX& rate() const { return rate_; }
  const MatX& gradients() const { return Phi_; }

 private:
  const Tree* tree_;
  int rows_;
  MatX Phi_, MinvPhi_;
  VecX phi_, rate_;
  Reduction reduction_;
};

}  // namespace contactvi

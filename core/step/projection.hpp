// Impulses on a system with constraints: what the constraints answer at once.
//
// An impulse along a row W comes with those of the constraints that keep d phi/dt: p+ = p + (W - Phi mu) lambda with
// mu = (Phi^T M^-1 Phi)^+ Phi^T M^-1 W. So the projected row takes W's place, and its Delassus matrix is that of the
// constrained system. Where a constraint moves by itself the row's velocity has a part of its own: offset = -mu . rate.
#pragma once

#include "base/reduction.hpp"
#include "model/constraints.hpp"
#include "step/integrator.hpp"

namespace contactvi {

class Projection {
 public:
  explicit Projection(const Tree& tree);
  bool any() const { return rows_ > 0; }
  // The constraints at q and t; the integrator's node must be placed there.
  void set(Integrator& integrator, const Placements& at, const VecCRef& q, double t);
  // Rows W (nv, k) and M^-1 W become projected ones; mu (rows, k), offset (k,).
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

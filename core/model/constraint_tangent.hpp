// How constraints phi(q, t) = 0 change with the configuration: the derivative of their gradients along a direction,
// which is the second derivative of phi. Engine coordinates.
#pragma once

#include "model/body_twists.hpp"
#include "model/constraints.hpp"

namespace contactvi {

class ConstraintTangent {
 public:
  explicit ConstraintTangent(const Tree& tree);

  // Takes all constraints of the tree at q and the time t [s].
  void take(const VecCRef& q, double t);
  int rows() const { return static_cast<int>(phi_.size()); }
  // Residuals, their gradients as columns (nv, rows), their rates at fixed q, and the rates of those. No gradient
  // depends on time.
  const VecX& residuals() const { return phi_; }
  const MatX& gradients() const { return W_; }
  const VecX& rates() const { return rate_; }
  const VecX& accelerations() const { return acceleration_; }
  // The derivative of the gradients along dq, shape (nv,), as columns of dW, (nv, rows).
  void change(const VecCRef& dq, Eigen::Ref<MatX> dW);

 private:
  const Tree* tree_;
  BodyTwists twists_;
  VecX q_, phi_, rate_, acceleration_;
  MatX W_;
};

}  // namespace contactvi

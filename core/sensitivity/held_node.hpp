// The rows of a held step at one of its nodes, and how they change with the configuration there.
#pragma once

#include "model/constraint_tangent.hpp"
#include "step/node_chart.hpp"

namespace contactvi {

class HeldNode {
 public:
  explicit HeldNode(const Tree& tree);

  // The rows at q and t [s], at the displacement X from the start of the step, with impulses lambda (rows,).
  void take(const VecX& q, double t, const VecX& X, const VecX& lambda);
  int rows() const { return static_cast<int>(gradients_.cols()); }
  const VecX& displacement() const { return X_; }
  const NodeChart& chart() const { return chart_; }
  // W (nv, rows), W lambda, and d(W lambda)/dq.
  const MatX& gradients() const { return gradients_; }
  const VecX& force() const { return force_; }
  const MatX& force_change() const { return bend_; }
  // d(W^T v)/dq at a constant v, (rows, nv).
  MatX speed_change(const VecX& v);
  // Derivatives of the rows' displacements by time at a fixed configuration, (rows,).
  const VecX& rates() const { return constraints_.rates(); }
  const VecX& accelerations() const { return constraints_.accelerations(); }

 private:
  NodeChart chart_;
  ConstraintTangent constraints_;
  VecX X_, force_;
  MatX gradients_, bend_, change_;
};

}  // namespace contactvi

#include "sensitivity/held_node.hpp"

namespace contactvi {

HeldNode::HeldNode(const Tree& tree)
    : chart_(tree), constraints_(tree), bend_(tree.nv, tree.nv), change_(tree.nv, tree.elements.constraint_rows) {}

void HeldNode::take(const VecX& q, double t, const VecX& X, const VecX& lambda) {
  X_ = X;
  chart_.take(X);
  constraints_.take(q, t);
  gradients_ = constraints_.gradients();
  force_ = gradients_ * lambda;
  for (Eigen::Index k = 0; k < bend_.cols(); ++k) {
    constraints_.change(VecX::Unit(bend_.cols(), k), change_);
    bend_.col(k) = change_ * lambda;
  }
}

MatX HeldNode::speed_change(const VecX& v) {
  MatX found(rows(), v.size());
  for (Eigen::Index k = 0; k < v.size(); ++k) {
    constraints_.change(VecX::Unit(v.size(), k), change_);
    found.col(k) = change_.transpose() * v;
  }
  return found;
}

}  // namespace contactvi

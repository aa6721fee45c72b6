#include "step/projection.hpp"

namespace contactvi {

void close_rates(StepEquations& equations, Reduction& reduction, const MatX& W, const VecX& rate, VecRef p, VecX& v,
                 VecRef mu) {
  const Eigen::Index rows = W.cols();
  MatX X(p.size(), rows + 1);
  X << W, p;
  equations.solve_masses(X);
  const auto moved = X.leftCols(rows);
  v = X.col(rows);
  reduction.set(W.transpose() * moved, static_cast<int>(rows));
  reduction.right_side(W.transpose() * v + rate);
  reduction.complete(VecX(), mu);
  p += W * mu;
  v += moved * mu;
}

Projection::Projection(const Tree& tree)
    : tree_(&tree),
      rows_(tree.elements.constraint_rows),
      Phi_(tree.nv, rows_),
      MinvPhi_(tree.nv, rows_),
      phi_(rows_),
      rate_(VecX::Zero(rows_)) {}

void Projection::set(StepEquations& equations, const Placements& at, const VecCRef& q, double t) {
  evaluate_constraints(*tree_, at, q, t, phi_, Phi_, rate_);
  MinvPhi_ = Phi_;
  equations.solve_masses(MinvPhi_);
  reduction_.set(Phi_.transpose() * MinvPhi_, rows_);
}

void Projection::apply(Eigen::Ref<MatX> W, Eigen::Ref<MatX> MinvW, Eigen::Ref<MatX> mu, VecRef offset) {
  VecX none(0), answer(rows_);
  for (Eigen::Index k = 0; k < W.cols(); ++k) {
    reduction_.right_side(Phi_.transpose() * MinvW.col(k));
    reduction_.complete(none, answer);
    mu.col(k) = -answer;
    W.col(k).noalias() += Phi_ * answer;
    MinvW.col(k).noalias() += MinvPhi_ * answer;
    offset[k] = answer.dot(rate_);
  }
}

}  // namespace contactvi

#include "step/stiff_terms.hpp"

#include <algorithm>

namespace contactvi {

StiffTerms::StiffTerms(const Tree& tree, const Stages& stages)
    : tree_(&tree), columns_(stages.field().stiff_columns()), q_(tree.nq), v_(tree.nv), x_(tree.nv) {
  if (columns_ == 0) return;
  at_.resize(stages.count());
  for (Terms& terms : at_) {
    terms.J.resize(tree.nv, columns_);
    terms.Z.resize(tree.nv, columns_);
    terms.C.resize(columns_, columns_);
  }
  kept_.resize(static_cast<std::size_t>(tree.nv) * stages.padded());
}

void StiffTerms::factor(Stages& stages, const VecCRef& q0) {
  const int S = stages.padded(), s = stages.count(), n = tree_->nv;
  int used = 0;
  active_ = false;
  for (int i = 0; i < s; ++i) {
    stages.configuration(q0, i, q_);
    for (int d = 0; d < n; ++d) v_[d] = stages.v()[d * S + i];
    const auto [damping, stiffness] = stages.shares(i);
    at_[i].used = stages.field().newton_terms(stages.time(i), q_, v_, damping, stiffness, at_[i].J, at_[i].C);
    used = std::max(used, at_[i].used);
    active_ |= !at_[i].C.isZero(0) && at_[i].C.allFinite() && at_[i].J.allFinite();
  }
  if (!active_) return;
  std::copy_n(stages.dv(), kept_.size(), kept_.data());
  for (int k = 0; k < used; ++k) {
    for (int d = 0; d < n; ++d)
      for (int i = 0; i < S; ++i) stages.dv()[d * S + i] = at_[std::min(i, s - 1)].J(d, k);
    stages.solve();
    for (int i = 0; i < s; ++i)
      for (int d = 0; d < n; ++d) at_[i].Z(d, k) = stages.dv()[d * S + i];
  }
  std::copy_n(kept_.data(), kept_.size(), stages.dv());
  for (Terms& terms : at_) {
    if (terms.used == 0) continue;
    terms.small.noalias() = terms.Jt() * terms.Z.leftCols(terms.used);
    terms.small = terms.factors() * terms.small;
    terms.small.diagonal().array() += 1.0;
    terms.lu.compute(terms.small);
  }
}

void StiffTerms::correct(Stages& stages) {
  if (!active_) return;
  const int S = stages.padded(), n = tree_->nv;
  for (int i = 0; i < stages.count(); ++i) {
    const Terms& terms = at_[i];
    if (terms.used == 0) continue;
    for (int d = 0; d < n; ++d) x_[d] = stages.dv()[d * S + i];
    const VecX change = terms.Z.leftCols(terms.used) * terms.lu.solve(terms.factors() * (terms.Jt() * x_));
    if (!change.allFinite()) continue;  // the iteration that made it fails
    double error = 0.0;
    for (int d = 0; d < n; ++d) {
      stages.dv()[d * S + i] -= change[d];
      stages.v()[d * S + i] -= change[d];
      error += stages.residual()[d * S + i] * stages.dv()[d * S + i];
    }
    stages.set_error(i, error);
  }
}

// The transpose has C^T for C: x - Z C^T (1 + C J^T Z)^-T J^T x.
void StiffTerms::correct_solution(Stages& stages, bool transposed) {
  if (!active_) return;
  const int S = stages.padded(), s = stages.count(), n = tree_->nv;
  for (int i = 0; i < s; ++i) {
    const Terms& terms = at_[i];
    if (terms.used == 0) continue;
    for (int d = 0; d < n; ++d) x_[d] = stages.dv()[d * S + i];
    const VecX y = terms.Jt() * x_;
    VecX z = transposed ? VecX(terms.lu.transpose().solve(y)) : VecX(terms.factors() * y);
    z = transposed ? VecX(terms.factors().transpose() * z) : VecX(terms.lu.solve(z));
    const VecX change = terms.Z.leftCols(terms.used) * z;
    if (!change.allFinite()) continue;  // the iteration that made it fails
    for (int d = 0; d < n; ++d)
      for (int k = i; k < (i + 1 == s ? S : i + 1); ++k) stages.dv()[d * S + k] -= change[d];
  }
}

void StiffTerms::correct(Eigen::Ref<MatX> X) const {
  if (!active_) return;
  const Terms& terms = at_.front();
  X -= terms.Z.leftCols(terms.used) * terms.lu.solve(terms.factors() * (terms.Jt() * X));
}

}  // namespace contactvi

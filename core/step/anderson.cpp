#include "step/anderson.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

AndersonAcceleration::AndersonAcceleration(int nv, const Stages& stages)
    : nv_(nv), s_(stages.count()), S_(stages.padded()) {}

double AndersonAcceleration::dot(const AlignedArray& a, const AlignedArray& b) const {
  double sum = 0.0;
  for (int d = 0; d < nv_; ++d)
    for (int i = 0; i < s_; ++i) sum += a[d * S_ + i] * b[d * S_ + i];
  return sum;
}

void AndersonAcceleration::push(const Stages& stages) {
  const std::size_t size = static_cast<std::size_t>(nv_) * S_;
  if (history_.empty())
    for (int k = 0; k <= kDepth; ++k) history_.push_back({AlignedArray(size), AlignedArray(size), AlignedArray(size)});
  std::rotate(history_.begin(), history_.end() - 1, history_.end());
  Iteration &now = history_[0], &last = history_[1];
  std::copy(stages.v(), stages.v() + size, now.v.data());
  std::copy(stages.dv(), stages.dv() + size, now.f.data());
  std::copy(stages.residual(), stages.residual() + size, now.r.data());
  if (count_ == 0) return;
  for (std::size_t i = 0; i < size; ++i) {
    last.v[i] = now.v[i] - last.v[i];
    last.f[i] = now.f[i] - last.f[i];
    last.r[i] = now.r[i] - last.r[i];
  }
}

// Least squares |f - sum gamma_j df_j| by Cholesky of the Gram matrix, over as many columns as are independent.
int AndersonAcceleration::weigh(int columns, double* gamma) const {
  double L[kDepth][kDepth], y[kDepth];
  int used = 0;
  for (; used < columns; ++used) {
    const Iteration& column = history_[used + 1];
    const double full = dot(column.f, column.r);
    double pivot = full, right = dot(column.f, history_[0].r);
    for (int k = 0; k < used; ++k) {
      double entry = dot(history_[k + 1].f, column.r);
      for (int l = 0; l < k; ++l) entry -= L[used][l] * L[k][l];
      L[used][k] = entry / L[k][k];
      pivot -= L[used][k] * L[used][k];
      right -= L[used][k] * y[k];
    }
    if (!(pivot > 1e-12 * std::abs(full))) break;
    L[used][used] = std::sqrt(pivot);
    y[used] = right / L[used][used];
  }
  for (int k = used - 1; k >= 0; --k) {
    gamma[k] = y[k];
    for (int l = k + 1; l < used; ++l) gamma[k] -= L[l][k] * gamma[l];
    gamma[k] /= L[k][k];
  }
  return used;
}

void AndersonAcceleration::apply(Stages& stages) {
  push(stages);
  double gamma[kDepth];
  const int used = weigh(count_, gamma);
  count_ = std::min(count_ + 1, kDepth);
  const std::size_t size = static_cast<std::size_t>(nv_) * S_;
  for (int k = 0; k < used; ++k)
    for (std::size_t i = 0; i < size; ++i) stages.v()[i] -= gamma[k] * history_[k + 1].v[i];
}

}  // namespace contactvi

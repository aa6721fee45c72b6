#include "step/anderson.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {
// In this order, whatever the instruction set.
double dot(const VecX& a, const VecX& b) {
  double sum = 0.0;
  for (Eigen::Index i = 0; i < a.size(); ++i) sum += a[i] * b[i];
  return sum;
}
}  // namespace

void AndersonAcceleration::push(const VecX& x, const VecX& f, const VecX& r) {
  history_.resize(kDepth + 1);
  std::rotate(history_.begin(), history_.end() - 1, history_.end());
  Iteration &now = history_[0], &last = history_[1];
  now.x = x;
  now.f = f;
  now.r = r;
  if (count_ == 0) return;
  last.x = x - last.x;
  last.f = f - last.f;
  last.r = r - last.r;
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

void AndersonAcceleration::apply(VecX& x, const VecX& f, const VecX& r) {
  push(x, f, r);
  double gamma[kDepth];
  const int used = weigh(count_, gamma);
  count_ = std::min(count_ + 1, kDepth);
  for (int k = 0; k < used; ++k) x -= gamma[k] * history_[k + 1].x;
}

}  // namespace contactvi

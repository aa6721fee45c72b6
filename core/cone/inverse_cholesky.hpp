// Inverse of the Cholesky factor of a small matrix. Eigen's triangular solvers are made for large ones.
#pragma once

#include <Eigen/Core>
#include <cmath>

namespace contactvi {

template <int N>
using SquareMap = Eigen::Map<Eigen::Matrix<double, N, N>>;

// Replaces the lower triangle of a positive definite A by the inverse of its Cholesky factor, zeros above.
template <int N>
bool invert_cholesky(SquareMap<N> A) {
  const int n = static_cast<int>(A.rows());
  for (int j = 0; j < n; ++j) {
    for (int k = 0; k < j; ++k) {
      const double f = A(j, k);
      for (int i = j; i < n; ++i) A(i, j) -= f * A(i, k);
    }
    if (!(A(j, j) > 0.0) || !std::isfinite(A(j, j))) return false;
    const double scale = 1.0 / std::sqrt(A(j, j));
    for (int i = j; i < n; ++i) A(i, j) *= scale;
  }
  for (int j = 0; j < n; ++j) {
    A(j, j) = 1.0 / A(j, j);
    for (int i = j + 1; i < n; ++i) {
      double sum = 0.0;
      for (int k = j; k < i; ++k) sum += A(i, k) * A(k, j);
      A(i, j) = -sum / A(i, i);
    }
    for (int i = 0; i < j; ++i) A(i, j) = 0.0;
  }
  return true;
}

}  // namespace contactvi

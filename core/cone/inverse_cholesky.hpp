// Inverses of small positive definite matrices, by their Cholesky factors. Eigen's triangular solvers are made for
// large ones.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <type_traits>

#include "base/numerics.hpp"

namespace contactvi {

template <int N>
using SquareMap = Eigen::Map<Eigen::Matrix<double, N, N>>;

// y -= f x for n numbers; of a size that the compiler knows it needs no help.
template <int N>
inline void subtract(double* y, double f, const double* x, int n) {
  if constexpr (N == Eigen::Dynamic)
    Eigen::Map<VecX>(y, n) -= f * Eigen::Map<const VecX>(x, n);
  else
    for (int i = 0; i < n; ++i) y[i] -= f * x[i];
}

// Replaces the lower triangle of a positive definite A by its Cholesky factor.
template <int N>
bool factor_cholesky(SquareMap<N> A) {
  const int n = static_cast<int>(A.rows());
  for (int j = 0; j < n; ++j) {
    for (int k = 0; k < j; ++k) subtract<N>(&A(j, j), A(j, k), &A(j, k), n - j);
    if (!(A(j, j) > 0.0) || !std::isfinite(A(j, j))) return false;
    const double scale = 1.0 / std::sqrt(A(j, j));
    for (int i = j; i < n; ++i) A(i, j) *= scale;
  }
  return true;
}

// Replaces the lower triangle of a positive definite A by the inverse of its Cholesky factor, zeros above.
template <int N>
bool invert_cholesky(SquareMap<N> A) {
  if (!factor_cholesky<N>(A)) return false;
  const int n = static_cast<int>(A.rows());
  // Column by column from the last one: the columns behind are those of the inverse by then.
  for (int j = n - 1; j >= 0; --j) {
    A(j, j) = 1.0 / A(j, j);
    for (int k = n - 1; k > j; --k) {
      const double f = A(j, j) * A(k, j);
      A(k, j) = -f * A(k, k);
      if (k + 1 < n) subtract<N>(&A(k + 1, j), f, &A(k + 1, k), n - k - 1);
    }
    for (int i = 0; i < j; ++i) A(i, j) = 0.0;
  }
  return true;
}

// inverse <- A^-1 of a symmetric A, of which the lower triangle is read. False, and the inverse not a number, if A is
// not positive definite.
inline bool invert_positive(const MatX& A, MatX& inverse) {
  const auto invert = [&](auto size) {
    constexpr int N = decltype(size)::value;
    MatX factor = A;
    const SquareMap<N> L(factor.data(), A.rows(), A.cols());
    const bool positive = invert_cholesky<N>(L);
    SquareMap<N> X(inverse.data(), A.rows(), A.cols());
    if (positive)
      X.noalias() = L.transpose() * L;
    else
      X.setConstant(std::nan(""));
    return positive;
  };
  inverse.resize(A.rows(), A.cols());
  return A.rows() == 6 ? invert(std::integral_constant<int, 6>())
                       : invert(std::integral_constant<int, Eigen::Dynamic>());
}

}  // namespace contactvi

#include "base/small_linear.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/instruction_sets.hpp"

namespace contactvi {

namespace {

constexpr double kRankCut = 1e-11;  // of the largest pivot of QR: the rank ends below
constexpr double kZeroRow = 1e-13;  // of the largest entry: a row of smaller ones is rounding

// In four sums, which the processor makes side by side.
[[gnu::always_inline]] inline double dot(const double* __restrict x, const double* __restrict y, int n) {
  double sums[4] = {0.0, 0.0, 0.0, 0.0};
  int i = 0;
  for (; i + 4 <= n; i += 4)
    for (int k = 0; k < 4; ++k) sums[k] += x[i + k] * y[i + k];
  for (; i < n; ++i) sums[0] += x[i] * y[i];
  return (sums[0] + sums[1]) + (sums[2] + sums[3]);
}

// x and y do not overlap.
[[gnu::always_inline]] inline void axpy(double a, const double* __restrict x, double* __restrict y, int n) {
  for (int i = 0; i < n; ++i) y[i] += a * x[i];
}

// Householder vector of x (n,), stored over x with x[0] = v_0; returns the value that x is mapped to, beta = 2/|v|^2.
[[gnu::always_inline]] inline double householder(double* x, int n, double& beta) {
  const double length = std::sqrt(dot(x, x, n));
  beta = 0.0;
  if (length == 0.0) return 0.0;
  const double value = x[0] > 0.0 ? -length : length;
  x[0] -= value;
  beta = 2.0 / dot(x, x, n);
  return value;
}

// LU with partial pivoting over f (n, n); false if a pivot is not above `least` of the largest. order: of the rows.
CONTACTVI_WIDE_VECTORS bool triangles(double* __restrict f, int n, double least, int* order) {
  double smallest = 1.0, largest = 0.0;
  for (int k = 0; k < n; ++k) {
    double* column = f + k * n;
    int pivot = k;
    for (int i = k + 1; i < n; ++i)
      if (std::abs(column[i]) > std::abs(column[pivot])) pivot = i;
    const double size = std::abs(column[pivot]);
    largest = std::max(largest, size);
    smallest = k == 0 ? size : std::min(smallest, size);
    if (!(smallest > least * largest)) return false;
    order[k] = pivot;
    if (pivot != k)
      for (int j = 0; j < n; ++j) std::swap(f[k + j * n], f[pivot + j * n]);
    const double inverse = 1.0 / column[k];
    for (int i = k + 1; i < n; ++i) column[i] *= inverse;
    for (int j = k + 1; j < n; ++j) axpy(-f[k + j * n], column + k + 1, f + k + 1 + j * n, n - k - 1);
  }
  return true;
}

// QR with column pivoting over f (n, n); returns the rank. order: of the columns; head, beta: of the reflections.
CONTACTVI_WIDE_VECTORS int pivoted_qr(double* f, int n, double* norms, int* order, double* head, double* beta) {
  double first = 0.0;
  for (int k = 0; k < n; ++k) {
    // The norms are computed anew each time: the matrices are small, and downdated norms lose their digits where the
    // rank ends.
    int pivot = k;
    for (int j = k; j < n; ++j) {
      norms[j] = dot(f + k + j * n, f + k + j * n, n - k);
      if (norms[j] > norms[pivot]) pivot = j;
    }
    const double size = std::sqrt(norms[pivot]);
    if (k == 0) first = size;
    if (!(size > kRankCut * first)) return k;
    if (pivot != k) {
      std::swap_ranges(f + k * n, f + (k + 1) * n, f + pivot * n);
      std::swap(order[k], order[pivot]);
    }
    double* v = f + k + k * n;
    const double value = householder(v, n - k, beta[k]);
    for (int j = k + 1; j < n; ++j) axpy(-beta[k] * dot(v, f + k + j * n, n - k), v, f + k + j * n, n - k);
    head[k] = v[0];
    v[0] = value;
  }
  return n;
}

// QR of t (n, rank), over it.
CONTACTVI_WIDE_VECTORS void plain_qr(double* t, int n, int rank, double* diagonal, double* beta) {
  for (int k = 0; k < rank; ++k) {
    double* v = t + k + k * n;
    diagonal[k] = householder(v, n - k, beta[k]);
    for (int j = k + 1; j < rank; ++j) axpy(-beta[k] * dot(v, t + k + j * n, n - k), v, t + k + j * n, n - k);
  }
}

}  // namespace

void SmallLinear::reserve(int size) {
  if (static_cast<int>(y_.size()) >= size) return;
  for (auto* matrix : {&a_, &f_, &t_}) matrix->resize(size * size);
  for (auto* vector : {&scale_, &y_, &norms_, &weight_, &head_, &beta_, &beta_2_, &diagonal_}) vector->resize(size);
  order_.resize(size);
}

double SmallLinear::largest_scale() const {
  double largest = 0.0;
  for (int i = 0; i < n_; ++i) largest = std::max(largest, scale_[i]);
  return largest;
}

bool SmallLinear::factor(double least) {
  const int n = n_;
  double* __restrict f = f_.data();
  double* scale = scale_.data();
  const double* a = a_.data();
  std::fill_n(scale, n, 0.0);
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) scale[i] = std::max(scale[i], std::abs(a[i + j * n]));
  const double zero = least > 0.0 ? kZeroRow * largest_scale() : 0.0;
  for (int i = 0; i < n; ++i) {
    if (!(scale[i] > zero)) return false;
    scale[i] = 1.0 / scale[i];
  }
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) f[i + j * n] = a[i + j * n] * scale[i];
  return triangles(f, n, least, order_.data());
}

void SmallLinear::substitute(double* x) {
  const int n = n_;
  const double* f = f_.data();
  for (int i = 0; i < n; ++i) x[i] *= scale_[i];
  for (int k = 0; k < n; ++k) std::swap(x[k], x[order_[k]]);
  for (int k = 0; k < n; ++k) axpy(-x[k], f + k + 1 + k * n, x + k + 1, n - k - 1);
  for (int k = n - 1; k >= 0; --k) {
    x[k] /= f[k + k * n];
    axpy(-x[k], f + k * n, x, k);
  }
}

// QR of R^T = Q2 S, R the first rows of f_: y_ of least norm with R y = c is Q2 z, S^T z = c.
void SmallLinear::factor_trapezoid() {
  const int n = n_;
  double* t = t_.data();
  for (int k = 0; k < rank_; ++k)
    for (int j = 0; j < n; ++j) t[j + k * n] = j < k ? 0.0 : f_[k + j * n];
  plain_qr(t, n, rank_, diagonal_.data(), beta_2_.data());
}

void SmallLinear::minimum_norm(const double* weight, double* x) {
  const int n = n_;
  std::fill_n(scale_.data(), n, 0.0);
  for (int j = 0; j < n; ++j) {
    order_[j] = j;
    weight_[j] = weight[j];
    for (int i = 0; i < n; ++i) scale_[i] = std::max(scale_[i], std::abs(a_[i + j * n]));
  }
  const double zero = kZeroRow * largest_scale();
  for (int i = 0; i < n; ++i) scale_[i] = scale_[i] > zero ? 1.0 / scale_[i] : 0.0;
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) f_[i + j * n] = a_[i + j * n] * scale_[i] / weight[j];
  rank_ = pivoted_qr(f_.data(), n, norms_.data(), order_.data(), head_.data(), beta_.data());
  factor_trapezoid();
  minimum_norm_again(x);
}

void SmallLinear::minimum_norm_again(double* x) {
  const int n = n_;
  double *f = f_.data(), *y = y_.data();
  const double* t = t_.data();
  for (int i = 0; i < n; ++i) x[i] *= scale_[i];
  for (int k = 0; k < rank_; ++k) {
    double* v = f + k + k * n;
    const double value = v[0];
    v[0] = head_[k];
    axpy(-beta_[k] * dot(v, x + k, n - k), v, x + k, n - k);
    v[0] = value;
  }
  std::fill_n(y, n, 0.0);
  for (int k = 0; k < rank_; ++k) y[k] = (x[k] - dot(t + k * n, y, k)) / diagonal_[k];
  for (int k = rank_ - 1; k >= 0; --k) {
    const double* v = t + k + k * n;
    axpy(-beta_2_[k] * dot(v, y + k, n - k), v, y + k, n - k);
  }
  for (int j = 0; j < n; ++j) x[order_[j]] = y[j] / weight_[order_[j]];
}

}  // namespace contactvi

#include "base/small_linear.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace contactvi {

namespace {

constexpr double kSmallestPivot = 1e-9;  // of the largest: LU is not trusted below
constexpr double kRankCut = 1e-11;       // of the largest pivot of QR: the rank ends below
constexpr double kZeroRow = 1e-13;       // of the largest entry: a row of smaller ones is rounding

double dot(const double* x, const double* y, int n) {
  double sum = 0.0;
  for (int i = 0; i < n; ++i) sum += x[i] * y[i];
  return sum;
}

// x and y do not overlap.
void axpy(double a, const double* __restrict x, double* __restrict y, int n) {
  for (int i = 0; i < n; ++i) y[i] += a * x[i];
}

// Householder vector of x (n,), stored over x with x[0] = v_0; returns the value that x is mapped to, beta = 2/|v|^2.
double householder(double* x, int n, double& beta) {
  const double length = std::sqrt(dot(x, x, n));
  beta = 0.0;
  if (length == 0.0) return 0.0;
  const double value = x[0] > 0.0 ? -length : length;
  x[0] -= value;
  beta = 2.0 / dot(x, x, n);
  return value;
}

}  // namespace

void SmallLinear::reserve(int size) {
  if (static_cast<int>(y_.size()) >= size) return;
  for (auto* matrix : {&a_, &f_, &t_}) matrix->resize(size * size);
  for (auto* vector : {&scale_, &y_, &norms_}) vector->resize(size);
  order_.resize(size);
}

double SmallLinear::largest_scale() const {
  double largest = 0.0;
  for (int i = 0; i < n_; ++i) largest = std::max(largest, scale_[i]);
  return largest;
}

bool SmallLinear::factor() {
  const int n = n_;
  double* __restrict f = f_.data();
  double* scale = scale_.data();
  const double* a = a_.data();
  std::fill_n(scale, n, 0.0);
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) scale[i] = std::max(scale[i], std::abs(a[i + j * n]));
  const double zero = kZeroRow * largest_scale();
  for (int i = 0; i < n; ++i) {
    if (!(scale[i] > zero)) return false;
    scale[i] = 1.0 / scale[i];
  }
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) f[i + j * n] = a[i + j * n] * scale[i];
  double smallest = 1.0, largest = 0.0;
  for (int k = 0; k < n; ++k) {
    double* column = f + k * n;
    int pivot = k;
    for (int i = k + 1; i < n; ++i)
      if (std::abs(column[i]) > std::abs(column[pivot])) pivot = i;
    const double size = std::abs(column[pivot]);
    largest = std::max(largest, size);
    smallest = k == 0 ? size : std::min(smallest, size);
    if (!(smallest > kSmallestPivot * largest)) return false;
    order_[k] = pivot;
    if (pivot != k)
      for (int j = 0; j < n; ++j) std::swap(f[k + j * n], f[pivot + j * n]);
    const double inverse = 1.0 / column[k];
    for (int i = k + 1; i < n; ++i) column[i] *= inverse;
    for (int j = k + 1; j < n; ++j) axpy(-f[k + j * n], column + k + 1, f + k + 1 + j * n, n - k - 1);
  }
  return true;
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

// QR with column pivoting of f_; c becomes Q^T c; returns the rank.
int SmallLinear::pivoted_qr(double* c) {
  const int n = n_;
  double* f = f_.data();
  double first = 0.0;
  for (int k = 0; k < n; ++k) {
    // The norms are computed anew each time: the matrices are small, and downdated norms lose their digits where the
    // rank ends.
    int pivot = k;
    for (int j = k; j < n; ++j) {
      norms_[j] = dot(f + k + j * n, f + k + j * n, n - k);
      if (norms_[j] > norms_[pivot]) pivot = j;
    }
    const double size = std::sqrt(norms_[pivot]);
    if (k == 0) first = size;
    if (!(size > kRankCut * first)) return k;
    if (pivot != k) {
      std::swap_ranges(f + k * n, f + (k + 1) * n, f + pivot * n);
      std::swap(order_[k], order_[pivot]);
    }
    double beta;
    double* v = f + k + k * n;
    const double value = householder(v, n - k, beta);
    for (int j = k + 1; j < n; ++j) axpy(-beta * dot(v, f + k + j * n, n - k), v, f + k + j * n, n - k);
    axpy(-beta * dot(v, c + k, n - k), v, c + k, n - k);
    v[0] = value;
  }
  return n;
}

// y_ of least norm with R y = c, R the first `rank` rows of f_: QR of R^T = Q2 S, S^T z = c, y = Q2 z.
void SmallLinear::trapezoid_solve(int rank, const double* c) {
  const int n = n_;
  double *t = t_.data(), *y = y_.data();
  for (int k = 0; k < rank; ++k)
    for (int j = 0; j < n; ++j) t[j + k * n] = j < k ? 0.0 : f_[k + j * n];
  for (int k = 0; k < rank; ++k) {
    double* v = t + k + k * n;
    const double value = householder(v, n - k, norms_[k]);
    for (int j = k + 1; j < rank; ++j) axpy(-norms_[k] * dot(v, t + k + j * n, n - k), v, t + k + j * n, n - k);
    scale_[k] = value;  // diagonal of S; below it stands v
  }
  std::fill_n(y, n, 0.0);
  for (int k = 0; k < rank; ++k) y[k] = (c[k] - dot(t + k * n, y, k)) / scale_[k];
  for (int k = rank - 1; k >= 0; --k) {
    const double* v = t + k + k * n;
    axpy(-norms_[k] * dot(v, y + k, n - k), v, y + k, n - k);
  }
}

void SmallLinear::minimum_norm(const double* weight, double* x) {
  const int n = n_;
  std::fill_n(scale_.data(), n, 0.0);
  for (int j = 0; j < n; ++j) {
    order_[j] = j;
    for (int i = 0; i < n; ++i) scale_[i] = std::max(scale_[i], std::abs(a_[i + j * n]));
  }
  const double zero = kZeroRow * largest_scale();
  for (int i = 0; i < n; ++i) {
    scale_[i] = scale_[i] > zero ? 1.0 / scale_[i] : 0.0;
    x[i] *= scale_[i];
  }
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) f_[i + j * n] = a_[i + j * n] * scale_[i] / weight[j];
  const int rank = pivoted_qr(x);
  trapezoid_solve(rank, x);
  for (int j = 0; j < n; ++j) x[order_[j]] = y_[j] / weight[order_[j]];
}

}  // namespace contactvi

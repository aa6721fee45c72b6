// Small dense linear systems on buffers that are allocated once.
//
// Eigen's decompositions take about the same time, but round otherwise (by 2e-14 at size 6, 6e-12 at size 48), and
// allocate where the size changes. This one also scales the rows first, whose units differ.
#pragma once

#include <vector>

namespace contactvi {

// A x = c for one square A of changing size. Fill at(), then factor() and substitute(), or minimum_norm().
class SmallLinear {
 public:
  void reserve(int size);
  // Sets the size of A, whose entries are undefined afterwards.
  void resize(int size) { n_ = size; }
  double& at(int i, int j) { return a_[i + j * n_]; }

  static constexpr double kSmallestPivot = 1e-9;
  // LU with partial pivoting of the row-scaled matrix; false if a pivot is not above `least` of the largest.
  bool factor(double least = kSmallestPivot);
  // x: c on entry, solution on return. Only after a factor() that returned true.
  void substitute(double* x);
  // Solution of least squares with the least sum of (weight_i x_i)^2, directions below 1e-11 of the largest being cut
  // off (complete orthogonal decomposition). x: c on entry, solution on return; weight: n positive numbers.
  void minimum_norm(const double* weight, double* x);
  // The same with the factors of the last call, for another x.
  void minimum_norm_again(double* x);

 private:
  double largest_scale() const;
  void factor_trapezoid();

  int n_ = 0;
  std::vector<double> a_, f_, t_;  // the matrix, its factors, the transposed trapezoid
  std::vector<double> scale_, y_, norms_;
  std::vector<int> order_;
  // Of minimum_norm: rank, weights, of both orthogonal factors the reflections' first numbers and factors, diagonal of
  // the second triangle.
  int rank_ = 0;
  std::vector<double> weight_, head_, beta_, beta_2_, diagonal_;
};

}  // namespace contactvi

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

  // LU with partial pivoting of the row-scaled matrix; false if a pivot is below 1e-9 of the largest.
  bool factor();
  // x: c on entry, solution on return. Only after a factor() that returned true.
  void substitute(double* x);
  // Solution of least squares with the least sum of (weight_i x_i)^2, directions below 1e-11 of the largest being cut
  // off (complete orthogonal decomposition). x: c on entry, solution on return; weight: n positive numbers.
  void minimum_norm(const double* weight, double* x);

 private:
  double largest_scale() const;
  int pivoted_qr(double* c);
  void trapezoid_solve(int rank, const double* c);

  int n_ = 0;
  std::vector<double> a_, f_, t_;  // the matrix, its factors, the transposed trapezoid
  std::vector<double> scale_, y_, norms_;
  std::vector<int> order_;
};

}  // namespace contactvi

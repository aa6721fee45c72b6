// LU factorisation of a matrix with the sparsity of a kinematic tree: entry (i, j) is nonzero only if one of the two
// degrees of freedom is an ancestor of the other. Eliminating from the leaves to the root makes no fill-in
// (Featherstone, Rigid Body Dynamics Algorithms, section 6.5; here for nonsymmetric values), so a forest of n trees
// costs n small factorisations and Allegro's four fingers are four 4 x 4 blocks. No pivoting: the symmetric part of
// every matrix that comes here is a mass matrix plus nonnegative damping and stiffness.
#pragma once

#include <vector>

#include "numerics.hpp"

namespace contactvi {

class TreeLu {
 public:
  explicit TreeLu(const std::vector<int>& dof_parent);

  int size() const { return static_cast<int>(depth_.size()); }
  int depth(int k) const { return depth_[k]; }                // number of proper ancestors of dof k
  const int* path(int k) const { return &path_[start_[k]]; }  // those ancestors, root first

  // Raw entries to fill before factor(): A(k, k), A(k, path(k)[m]) and A(path(k)[m], k).
  double& diagonal(int k) { return diagonal_[k]; }
  double diagonal(int k) const { return diagonal_[k]; }
  double* row(int k) { return &row_[start_[k]]; }
  double* column(int k) { return &column_[start_[k]]; }
  void set_zero();

  // False when a pivot is not positive or not finite.
  bool factor();
  void solve(VecRef b) const;  // in place

 private:
  std::vector<int> depth_, start_, path_;
  std::vector<double> diagonal_, inverse_diagonal_, row_, column_;
};

}  // namespace contactvi

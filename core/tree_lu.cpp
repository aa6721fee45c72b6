#include "tree_lu.hpp"

#include <algorithm>

namespace contactvi {

TreeLu::TreeLu(const std::vector<int>& dof_parent) {
  const int n = static_cast<int>(dof_parent.size());
  depth_.resize(n);
  start_.resize(n);
  int total = 0;
  for (int k = 0; k < n; ++k) {
    depth_[k] = dof_parent[k] < 0 ? 0 : depth_[dof_parent[k]] + 1;
    start_[k] = total;
    total += depth_[k];
  }
  path_.resize(total + 1);  // one spare entry keeps &path_[start] valid for a last dof without ancestors
  row_.assign(total + 1, 0.0);
  column_.assign(total + 1, 0.0);
  diagonal_.assign(n, 0.0);
  inverse_diagonal_.assign(n, 0.0);
  for (int k = 0; k < n; ++k)
    for (int m = depth_[k] - 1, a = dof_parent[k]; m >= 0; --m, a = dof_parent[a]) path_[start_[k] + m] = a;
}

void TreeLu::set_zero() {
  std::fill(row_.begin(), row_.end(), 0.0);
  std::fill(column_.begin(), column_.end(), 0.0);
  std::fill(diagonal_.begin(), diagonal_.end(), 0.0);
}

bool TreeLu::factor() {
  for (int k = size() - 1; k >= 0; --k) {
    if (!(diagonal_[k] > 0.0)) return false;  // also catches NaN
    const double inverse = 1.0 / diagonal_[k];
    inverse_diagonal_[k] = inverse;
    const double* row_k = &row_[start_[k]];
    double* column_k = &column_[start_[k]];
    for (int l = depth_[k] - 1; l >= 0; --l) {
      const int j = path_[start_[k] + l];
      const double row_factor = row_k[l] * inverse, column_factor = column_k[l] * inverse;
      diagonal_[j] -= column_k[l] * row_factor;
      double* row_j = &row_[start_[j]];
      double* column_j = &column_[start_[j]];
      for (int m = 0; m < l; ++m) {
        column_j[m] -= column_k[m] * row_factor;
        row_j[m] -= column_factor * row_k[m];
      }
    }
    for (int l = 0; l < depth_[k]; ++l) column_k[l] *= inverse;
  }
  return true;
}

void TreeLu::solve(VecRef b) const {
  const int n = size();
  for (int k = n - 1; k >= 0; --k) {
    const double bk = b[k];
    if (bk == 0.0) continue;
    const int start = start_[k];
    for (int m = 0; m < depth_[k]; ++m) b[path_[start + m]] -= column_[start + m] * bk;
  }
  for (int k = 0; k < n; ++k) {
    const int start = start_[k];
    double bk = b[k];
    for (int m = 0; m < depth_[k]; ++m) bk -= row_[start + m] * b[path_[start + m]];
    b[k] = bk * inverse_diagonal_[k];
  }
}

}  // namespace contactvi

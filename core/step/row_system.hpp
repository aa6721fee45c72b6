// Linear equations for changes of impulses along rows, of which some may depend on each other.
#pragma once

#include <Eigen/LU>
#include <Eigen/QR>
#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

class RowSystem {
 public:
  // matrix (n, n): what the unknowns do to the residuals; scales of residuals and of unknowns, with which its entries
  // are near one. Unknowns of scale 0 are left out, with their equations.
  void set(const MatX& matrix, const VecX& row_scale, const VecX& scale);
  // The change of the unknowns that takes the residuals (n,) away. Where rows depend on each other it makes the
  // unknowns, which are `now`, the least ones, whatever they were.
  void solve(const VecX& residual, const VecX& now, VecX& change) const;
  // Whether rows depend on each other, so that other impulses keep them as well.
  bool is_redundant() const { return redundant_; }

 private:
  VecX row_scale_, scale_;
  MatX matrix_;            // of the unknowns in use, scaled
  std::vector<int> used_;  // which these are
  bool redundant_ = false;
  Eigen::PartialPivLU<MatX> lu_;
  Eigen::CompleteOrthogonalDecomposition<MatX> factor_;
};

}  // namespace contactvi

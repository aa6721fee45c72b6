// Linear equations for the impulses of contacts that may share a load.
#pragma once

#include <Eigen/SVD>

#include "base/numerics.hpp"

namespace contactvi {

// Solves linear equations whose rows may depend on each other: the solution of least norm.
class SharedLoad {
 public:
  void compute(const MatX& A);
  // x with A x + c = 0; false where the equations contradict each other. size: of the terms of c.
  bool solve(const VecX& c, const VecX& size, VecX& x) const;
  // The transpose of c -> x: the gradient in c from that in x.
  VecX solve_transposed(const VecX& lx) const;
  // What A does not determine, (n, free), orthonormal.
  const MatX& free() const { return free_; }

 private:
  MatX A_, free_;
  VecX scale_;
  Eigen::JacobiSVD<MatX> svd_;
  Eigen::Index rank_ = 0;
};

}  // namespace contactvi

// Linear equations for the impulses of contacts that may share a load, beside those of constraints.
#pragma once

#include <Eigen/SVD>

#include "base/numerics.hpp"

namespace contactvi {

// Solves linear equations whose rows may depend on each other: the solution of least norm. The first rows may be those
// of bilateral constraints, which are eliminated as in the step (base/reduction.hpp): where they contradict each other,
// as they may along a direction that leaves them, they are solved to least squares.
class SharedLoad {
 public:
  // constraints: the number of these rows. turns: how many unknowns, the last ones, are no impulses but directions of
  // slips, which have units of their own.
  void compute(MatX A, int constraints = 0, int turns = 0);
  // x with A x + c = 0; false where equations besides the constraints contradict each other. size: of the terms of c.
  bool solve(const VecX& c, const VecX& size, VecX& x) const;
  // The transpose of c -> x: the gradient in c from that in x.
  VecX solve_transposed(const VecX& gradient) const;
  // What A does not determine, (n, free).
  const MatX& free() const { return free_; }

 private:
  void scale_turns(MatX& A, int turns);
  void eliminate(const MatX& A);
  void factor();
  bool solve_rest(const VecX& c, const VecX& size, VecX& x) const;
  VecX solve_rest_transposed(const VecX& lx) const;

  MatX A_, free_;
  VecX scale_, turn_scale_;
  Eigen::JacobiSVD<MatX> svd_;
  Eigen::Index rank_ = 0;
  // With the blocks A = [K, B; E, F], K of the constraints: K^+, K^+ B and E K^+. A_ is that of the rest, F - E K^+ B.
  Eigen::Index constraints_ = 0;
  bool redundant_ = false;
  MatX inverse_, across_, behind_;
};

}  // namespace contactvi

// Elimination of the first rows of a cone problem, those of equations: w = b + G lambda = 0 in them.
//
// The rest is a cone problem again, with the Delassus matrix of the system that obeys the equations,
//   G' = G_rr - G_re G_ee^+ G_er,   b' = b_r - G_re G_ee^+ b_e,   lambda_e = -G_ee^+ (b_e + G_er lambda_r).
// Equations may be redundant: the pseudoinverse, in rows scaled to a diagonal of ones, takes the least multipliers. What
// they leave of the rest may be singular too (a rod held at one end that leans on the ground): directions that could not
// move anyway are taken out of G' and b', so that rounding asks for no impulse in them.
#pragma once

#include <Eigen/QR>
#include <Eigen/SVD>
#include <vector>

#include "numerics.hpp"

namespace contactvi {

class Reduction {
 public:
  // Of the rest the first `checked` rows are without effect, and get no impulse, where the equations leave them no
  // motion.
  void set(const Eigen::Ref<const MatX>& G, int equations, int checked = 0);
  const MatX& matrix() const { return G_; }
  const VecX& right_side(const VecCRef& b);
  // all = (lambda_e, rest).
  void complete(const VecCRef& rest, VecRef all);
  int rank() const { return rank_; }

 private:
  int equations_ = 0, rank_ = 0;
  VecX scale_, b_, first_;
  MatX A_, across_, G_;  // across: G_ee^+ G_er
  void cut(const Eigen::Ref<const MatX>& G);

  std::vector<int> idle_;
  bool cut_ = false;
  VecX own_;   // scales of the rest, of G without the equations
  MatX kept_;  // projector on the directions that can move, in scaled rows
  Eigen::CompleteOrthogonalDecomposition<MatX> factor_;
};

}  // namespace contactvi

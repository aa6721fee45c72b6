// Elimination of the first rows of a cone problem, those of equations: w = b + G lambda = 0 in them.
//
// The rest is a cone problem again, with the Delassus matrix of the system that obeys the equations,
//   G' = G_rr - G_re G_ee^+ G_er,   b' = b_r - G_re G_ee^+ b_e,   lambda_e = -G_ee^+ (b_e + G_er lambda_r).
// Equations may be redundant: the pseudoinverse, in rows scaled to a diagonal of ones, takes the least multipliers.
#pragma once

#include <Eigen/QR>
#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

class Reduction {
 public:
  // Of the first `checked` rows of the rest those are told that the equations leave no motion of their own: impulses in
  // them have no effect but on the equations.
  void set(const Eigen::Ref<const MatX>& G, int equations, int checked = 0);
  const MatX& matrix() const { return G_; }
  const VecX& right_side(const VecCRef& b);
  // These rows, and their velocities at the last right side; there they have none.
  const std::vector<int>& idle() const { return idle_; }
  double idle_speed(std::size_t i) const { return idle_speed_[i]; }
  // all = (lambda_e, rest).
  void complete(const VecCRef& rest, VecRef all);
  int rank() const { return rank_; }

 private:
  int equations_ = 0, rank_ = 0;
  VecX scale_, b_, first_;
  MatX A_, across_, G_;  // across: G_ee^+ G_er
  std::vector<int> idle_;
  std::vector<double> idle_speed_;
  Eigen::CompleteOrthogonalDecomposition<MatX> factor_;
};

}  // namespace contactvi

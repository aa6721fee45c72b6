// Elimination of the first rows of a cone problem where these are equations, w = b + G lambda = 0.
//
// The rest is a cone problem again, with the Delassus matrix of the system that obeys the equations,
//   G' = G_rr - G_re G_ee^+ G_er,   b' = b_r - G_re G_ee^+ b_e,   lambda_e = -G_ee^+ (b_e + G_er lambda_r).
// Equations may be redundant: the pseudoinverse, in rows scaled to a diagonal of ones, gives the least multipliers.
#pragma once

#include <Eigen/QR>
#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

class Reduction {
 public:
  // Takes the matrix, whose first `equations` rows are eliminated. Among the first `checked` rows of the rest those are
  // found which the equations leave no motion of their own (idle): impulses in them act on the equations alone.
  void set(const Eigen::Ref<const MatX>& G, int equations, int checked = 0);
  // G' and b' of the rest, valid until the next call.
  const MatX& matrix() const { return G_; }
  const VecX& right_side(const VecCRef& b);
  // The idle rows, and the velocities that the last right side gave them; b' is zero there.
  const std::vector<int>& idle() const { return idle_; }
  double idle_speed(std::size_t i) const { return idle_speed_[i]; }
  // all = (lambda_e, rest), for the right side of the last call.
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

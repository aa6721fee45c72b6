// A matrix of square blocks, one for each pair of degrees of freedom that act on each other (DofPattern), factored from
// the leaves of the tree to its roots without fill-in.
//
// A block holds the stages of a step, (size, size) numbers in rows of stride() numbers, zero beyond the block. Right
// sides are panels: size rows per dof of a component, in its order, of `width` numbers, a multiple of 8; the columns
// lie side by side in the lanes. No rows are exchanged between blocks: the matrix is a mass matrix and terms that are
// small with the step. backward_error() tells what was lost.
#pragma once

#include <vector>

#include "base/aligned_array.hpp"
#include "lanes/lanes.hpp"
#include "model/dof_pattern.hpp"

namespace contactvi {

// Cancellation up to which solutions are good to 1e-12: their errors are about 20 times that of rounding times it, as
// measured on chains of 3 to 100 links (tests/derivatives/test_step_map.py).
constexpr double kMostCancellation = 200.0;

// The width of a panel for so many columns.
int padded_width(int columns);

class TreeBlocks {
 public:
  TreeBlocks(const DofPattern& pattern, int size);

  int size() const { return size_; }
  int stride() const { return stride_; }
  // Block of the row of an entry's dof and the column of the one on its path, and the reverse; diagonal ones are low.
  double* low(int entry) { return low_.data() + entry * area_; }
  double* up(int entry) { return up_.data() + entry * area_; }
  double* at(DofPattern::Pair pair) { return pair.low ? low(pair.entry) : up(pair.entry); }
  // False where a diagonal block is singular.
  bool factor();
  // Of the last factor: how much larger a diagonal block was than what the elimination of the dofs below has left of
  // it. So many times the rounding of its numbers counts in the result.
  double cancellation() const { return cancellation_; }
  // X <- matrix^-1 X.
  void solve(int component, double* X, int width);
  // Of X as a solution for the right sides B, which become the residuals B - matrix X: the largest of these, relative
  // to the sizes of the terms of the same column and dof.
  double backward_error(int component, const double* X, double* B, int width);

 private:
  bool invert(const double* block, double* negative_inverse) const;
  double largest(const double* block) const;
  void subtract(const double* block, const double* X, double* Y, int width, bool anew = false) const;

  const DofPattern* pattern_;
  int size_, stride_, area_;
  const LaneKernel* kernel_;
  AlignedArray low_, up_;                 // as they were given
  AlignedArray left_, right_, negative_;  // K(a, d), D^-1 K(d, a) and -D^-1 after the elimination of the dofs below
  double cancellation_ = 1.0;
  std::vector<double> of_X_, of_terms_;
};

}  // namespace contactvi

// Solves with the factor of a single stage for many right sides, which lie side by side in the lanes of the kernel.
#pragma once

#include <vector>

#include "base/aligned_array.hpp"
#include "step/stages.hpp"

namespace contactvi {

class ColumnSolver {
 public:
  ColumnSolver(const Tree& tree, const FlatModel& model);

  // X <- (M + diagonal)^-1 X, shape (nv, m), with the factor of stages, which has one stage. The digits of a column do
  // not depend on the others.
  void solve(const Stages& stages, Eigen::Ref<MatX> X);

 private:
  void solve_some(const Stages& stages, Eigen::Ref<MatX> X);
  void list_joints(const Eigen::Ref<MatX>& X);

  const Tree* tree_;
  const FlatModel* model_;
  const LaneKernel *few_, *many_;
  AlignedArray X_, work_;
  std::vector<int> root_;       // of each joint
  std::vector<char> moving_;    // per joint: whether it is the root of a tree on which a right side acts
  std::vector<int> joints_;     // of these trees,
  std::vector<int> dofs_;       // and their dofs,
  std::vector<int> couplings_;  // and the couplings of joints in them
};

}  // namespace contactvi

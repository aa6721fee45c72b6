// The matrix of Newton's method on the stage equations (lanes/lane_iteration.hpp), factored along the tree.
//
// Unknown are the changes du of the chart rates at the stages. With w_ij = h a_ij, and h (a_ij - b_j) on spherical
// joints, which keep their momentum balance beside it, the equations of a stage are
//   dP_x,i - sum_j w_ij dG_x,j = dp_0 [balls: d(J_r(X_1) (p_0 + h sum_j b_j Y_j))],  dX_i = h sum_j a_ij du_j,
// and the columns of a component of the tree (DofPattern) have only rows of that component. Where joints are coupled
// (model/followers.hpp), du = S dy: the matrix of the leaders' equations, S^T times these times S, stands in the rows
// and columns of the leaders, and 1 in those of the followers.
//
// Right sides and solutions of a component are panels, (dofs, stages) rows of `width` numbers (TreeBlocks).
#pragma once

#include "step/stage_matrices.hpp"
#include "step/tree_blocks.hpp"

namespace contactvi {

class NewtonMatrix {
 public:
  NewtonMatrix(const NewtonMatrix&) = delete;
  NewtonMatrix& operator=(const NewtonMatrix&) = delete;

 protected:
  struct Ball {
    int iv;
    const std::vector<int>& related;  // dofs
    Mat3 J1, Z1, R1;                  // J_r(X_1), d(J_r(X_1) y)/dX_1, exp(X_1)
    Vec3 p1;
  };
  // with_nodes: the derivatives at the start and at the end of the step as well.
  NewtonMatrix(const Tree& tree, int stages, bool with_nodes);
  ~NewtonMatrix() = default;

  int components() const { return static_cast<int>(pattern_.components().size()); }
  bool is_in(int component, int dof) const;
  // Calls visit(row, column, pair) for each pair of dofs of a component.
  template <class Visit>
  void each_pair(int component, Visit visit) const;
  // Takes a step: derivatives at its stages, which need not solve its equations. Then makes and factors the matrix;
  // false where elimination loses too many digits.
  void take_stages(const StepSolution& step);
  bool factor();
  void fold_blocks(TreeBlocks& blocks);
  // S^T of a panel with so many rows per dof; and the rows of followers from those of their leaders.
  void fold_rows(double* panel, int rows_per_dof, int width) const;
  void follow_rows(double* panel, int rows_per_dof, int width) const;
  double* row(double* panel, int dof, int stage, int width) const {
    return panel + (static_cast<std::size_t>(pattern_.place(dof)) * blocks_.size() + stage) * width;
  }
  // Of a solution: the displacement at the end by it, and what it adds to the sum of start momentum and forces, one row
  // per dof each. turn_ends makes of these, with what else they have got, the changes of the end of spherical joints.
  void sum_ends(int component, const double* solution, int width, double* moved, double* total) const;
  void turn_ends(int component, int width, double* moved, double* total) const;

  const Tree* tree_;
  const LaneKernel* kernel_;
  FlatModel model_;
  DofPattern pattern_;
  StageMatrices stages_;
  TreeBlocks blocks_;
  PairMatrix output_;  // of du in -sum_j h b_j dG_j, and of dY_j on spherical joints; points: stages
  std::vector<Ball> balls_;
  std::vector<int> ball_of_;  // per dof; -1: none
  // h a_ij and h (a_ij - b_j), [i * stride + j]; a product of one with a matrix at the stages; h b_j.
  AlignedArray hA_, balance_weight_, product_;
  double hb_[kMaxStages], minus_hb_[kMaxStages];

 private:
  void set_weights(double h);
  void set_balls(const StepSolution& step);
  void set_block(int row, DofPattern::Pair pair);
  void set_output(int row, DofPattern::Pair pair);
  void add_balance(const Ball& ball);
};

template <class Visit>
void NewtonMatrix::each_pair(int component, Visit visit) const {
  for (const int d : pattern_.components()[component]) {
    for (int g = 0; g < pattern_.level(d); ++g) {
      const int a = pattern_.on_path(d, g), entry = pattern_.entry(d, g);
      visit(d, a, DofPattern::Pair{true, entry});
      visit(a, d, DofPattern::Pair{false, entry});
    }
    visit(d, d, DofPattern::Pair{true, pattern_.diagonal(d)});
  }
}

}  // namespace contactvi

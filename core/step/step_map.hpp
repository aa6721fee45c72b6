// The derivative of a smooth step (q0, p0 or v0, tau, h) -> (q1, p1 or v1), all columns at once: the tangent of the
// stage equations (lanes/lane_iteration.hpp) as a matrix, factored along the tree.
//
// Unknown are the changes du of the chart rates at the stages. With w_ij = h a_ij, and h (a_ij - b_j) on spherical
// joints, which keep their momentum balance beside it, the equations of a stage are
//   dP_x,i - sum_j w_ij dG_x,j = dp_0 [balls: d(J_r(X_1) (p_0 + h sum_j b_j Y_j))],  dX_i = h sum_j a_ij du_j,
// and the columns of a component of the tree (DofPattern) have only rows of that component. Where joints are coupled
// (model/followers.hpp), du = S dy: the matrix of the leaders' equations, S^T times these times S, stands in the rows
// and columns of the leaders, and 1 in those of the followers.
//
// Engine coordinates: tangent vectors are body-fixed on spherical joints. The generalized force is in public ones.
#pragma once

#include "step/stage_matrices.hpp"
#include "step/tree_blocks.hpp"

namespace contactvi {

class StepMap {
 public:
  // in_velocities: states are (q, v), else (q, p).
  StepMap(const Tree& tree, int stages, bool in_velocities);
  StepMap(const StepMap&) = delete;
  StepMap& operator=(const StepMap&) = delete;

  // Whether so many columns cost less by it than by one tangent equation after the other: it takes two evaluations per
  // dof of the longest path, and an equation one per iteration, of which steps have 6 to 9.
  bool pays_for(int columns) const { return 2 * pattern_.depth() <= 6 * columns; }
  // Makes the derivative of a solved step. False where elimination gives no solution that is good to rounding: of long
  // chains, for example.
  bool take(const StepSolution& step);
  // Rows q1 and x1, columns q0, x0, tau and h, (2 nv, 3 nv + 1).
  const MatX& matrix() const { return matrix_; }
  // The change of the end, (nv, count) each, along changes of q0 and x0, of tau (or empty), all (nv, count), and of h.
  void apply(const MatX& q, const MatX& x, const MatX& tau, const VecX& h, MatX& q1, MatX& x1) const;

 private:
  struct Ball {
    int iv;
    const std::vector<int>& related;  // dofs
    Mat3 J1, Z1, R1;                  // J_r(X_1), d(J_r(X_1) y)/dX_1, exp(X_1)
    Vec3 p1;
  };
  // The columns of a component of so many dofs.
  static int columns_of(int dofs) { return 3 * dofs + 1; }
  int components() const { return static_cast<int>(pattern_.components().size()); }
  bool is_in(int component, int dof) const;
  // Calls visit(row, column, pair) for each pair of dofs of a component.
  template <class Visit>
  void each_pair(int component, Visit visit) const;
  void set_weights(double h);
  void set_balls(const StepSolution& step);
  void set_block(int row, DofPattern::Pair pair);
  void set_output(int row, DofPattern::Pair pair);
  void add_balance(const Ball& ball);
  void assemble();
  void fold_blocks(TreeBlocks& blocks);
  void fold_rows(double* panel, int rows_per_dof) const;
  void follow_rows(double* panel, int rows_per_dof) const;
  void fold_columns();
  bool factor_mass();
  void add_start(int row, int column, double change);
  void add_stages(int row, int column, const double* momentum, const double* force, const double* of_total);
  void add_pair(int row, int column, DofPattern::Pair pair);
  void add_inputs(int dof);
  void add_split_inputs(const SplitJoint& joint, const VecX& q0);
  void add_length(int row);
  void make_right_sides(int component, const StepSolution& step);
  double sampled_error(int component);
  bool solve(int component);
  void make_ends(int component);
  void to_velocities(int component);
  void store(int component);
  double* right_row(int dof, int stage) { return row(right_, dof, stage); }
  double* solution_row(int dof, int stage) { return row(solution_, dof, stage); }
  double* row(AlignedArray& panel, int dof, int stage) {
    return panel.data() + (static_cast<std::size_t>(pattern_.place(dof)) * blocks_.size() + stage) * width_;
  }
  double* total_row(int dof) { return total_.data() + static_cast<std::size_t>(pattern_.place(dof)) * width_; }
  double* turn_row(int dof) { return turn_.data() + static_cast<std::size_t>(pattern_.place(dof)) * width_; }

  const Tree* tree_;
  bool in_velocities_;
  const LaneKernel* kernel_;
  FlatModel model_;
  DofPattern pattern_;
  StageMatrices stages_;
  TreeBlocks blocks_, mass_;
  PairMatrix output_;  // of du in -sum_j h b_j dG_j, and of dY_j on spherical joints; points: stages
  std::vector<Ball> balls_;
  std::vector<int> ball_of_;    // per dof; -1: none
  std::vector<bool> is_split_;  // per dof: whether its input turns with a body
  // h a_ij and h (a_ij - b_j), [i * stride + j]; a product of one with a matrix at the stages; h b_j.
  AlignedArray hA_, balance_weight_, product_;
  double hb_[kMaxStages], minus_hb_[kMaxStages];
  MatX xi_;  // change of the displacements with h, (nv, s), and at the end
  VecX xi1_;
  // Of a component: its number of columns and this padded; right sides, solution and residuals; the sum of the start
  // momentum and the forces, which becomes x1; q1.
  int count_ = 0, width_ = 0;
  AlignedArray right_, solution_, residual_, sample_, total_, turn_;
  MatX matrix_;
};

template <class Visit>
void StepMap::each_pair(int component, Visit visit) const {
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

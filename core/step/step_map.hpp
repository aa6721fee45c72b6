// The derivative of a smooth step (q0, p0 or v0, tau, h) -> (q1, p1 or v1), all columns at once: the tangent of the
// stage equations as a matrix, with that of Newton's method on them.
//
// Engine coordinates: tangent vectors are body-fixed on spherical joints. The generalized force is in public ones.
#pragma once

#include "step/newton_matrix.hpp"

namespace contactvi {

class StepMap : private NewtonMatrix {
 public:
  // in_velocities: states are (q, v), else (q, p).
  StepMap(const Tree& tree, int stages, bool in_velocities);

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
  // The columns of a component of so many dofs.
  static int columns_of(int dofs) { return 3 * dofs + 1; }
  void set_lengthening();
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
  double* right_row(int dof, int stage) { return row(right_.data(), dof, stage, width_); }
  double* solution_row(int dof, int stage) { return row(solution_.data(), dof, stage, width_); }
  double* total_row(int dof) { return total_.data() + static_cast<std::size_t>(pattern_.place(dof)) * width_; }
  double* turn_row(int dof) { return turn_.data() + static_cast<std::size_t>(pattern_.place(dof)) * width_; }

  bool in_velocities_;
  TreeBlocks mass_;
  std::vector<bool> is_split_;  // per dof: whether its input turns with a body
  MatX xi_;                     // change of the displacements with h, (nv, s), and at the end
  VecX xi1_;
  // Of a component: its number of columns and this padded; right sides, solution and residuals; the sum of the start
  // momentum and the forces, which becomes x1; q1.
  int count_ = 0, width_ = 0;
  AlignedArray right_, solution_, residual_, sample_, total_, turn_;
  MatX matrix_;
};

}  // namespace contactvi

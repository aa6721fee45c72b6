// What changes of the momenta at the stages of a step, and of its start momentum, do to its rates, its velocities and
// the momentum at its end, by Newton's matrix on the stage equations: forces that depend on velocities and
// configurations couple the stages.
//
// Panels are (nv * stages) rows of columns side by side, row dof * stages + stage; rates and momenta stand in the
// charts of spherical joints.
#pragma once

#include "step/newton_matrix.hpp"

namespace contactvi {

using StagePanel = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

class StageResponse : private NewtonMatrix {
 public:
  StageResponse(const Tree& tree, int stages) : NewtonMatrix(tree, stages, false), panel_(0) {}

  // Takes a step, which need not be solved. False where the matrix cannot be factored without losing digits.
  bool take(const StepSolution& step);
  // From changes of the stages' momenta to those of their rates; where joints are coupled, S^T of momenta counts.
  void solve(const StagePanel& given, StagePanel& rates);
  // From changes of the rates to those of the velocities, (nv * stages, columns).
  void velocities(const StagePanel& rates, StagePanel& found) const;
  // The change of the momentum at the end, (nv, columns), from that of the sum of the start momentum and all impulses,
  // in the axes of the start, which it replaces.
  void end_momenta(const StagePanel& rates, StagePanel& momenta);

 private:
  double h_ = 0.0;
  AlignedArray panel_, moved_{0}, total_{0};
};

}  // namespace contactvi

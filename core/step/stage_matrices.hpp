// The derivatives at the stages of a solved step (local_tangent.hpp) with the forces of elements, in the coordinates of
// the step equations: displacements X in the chart at q0 and rates u = X'. Only those of spherical joints differ from
// the coordinates of velocities (ball_chart.hpp).
//
// With du the change of the rates, dX of the displacements and dq of the start,
//   dP_x = M du + B dX + B_q dq,  dG_x = C du + K dX + K_q dq,  dY = C_Y du + K_Y dX + K_Yq dq,
// Y = exp(X) G being the force on a spherical joint in the axes that its body has at the start of the step.
#pragma once

#include "model/force_tangent.hpp"
#include "step/ball_chart.hpp"
#include "step/local_tangent.hpp"

namespace contactvi {

// A solved step.
struct StepSolution {
  const VecX &q0, &p0;
  double h;
  const VecX& tau;  // public coordinates, or empty
  double time;
  const Servo* servo;
  const MatX& velocities;  // at the stages, (nv, s)
  // Engine's, at the start and the end, for derivatives in velocities; null: in momenta.
  const VecX *v0 = nullptr, *v1 = nullptr;
};

class StageMatrices {
 public:
  // with_nodes: at the start and at the end of the step as well.
  StageMatrices(const Tree& tree, const FlatModel& model, const DofPattern& pattern, int stages, bool with_nodes);

  void take(const StepSolution& step);
  const GaussTable& table() const { return values_.table(); }
  // Points of the matrices at the start and the end, in the coordinates of velocities.
  int start() const { return stages_; }
  int end() const { return stages_ + 1; }
  // Dofs that act on those of a spherical joint, numbered as in the tree; and its chart at a stage.
  const std::vector<int>& related(std::size_t ball) const { return related_[ball]; }
  const BallChart& chart(int ball, int stage) const { return charts_[ball * stages_ + stage]; }

  PairMatrix &M, &B, &C, &K;
  PairMatrix B_q, K_q;        // as B and K without spherical joints
  PairMatrix C_Y, K_Y, K_Yq;  // rows of spherical joints
  MatX X, u, G_x, Y;          // at the stages, (nv, s)
  VecX X1;                    // at the end of the step

 private:
  double* at(PairMatrix& matrix, int row, int column) const;
  void add_split_inputs(const StepSolution& step, int stage);
  void add_ball_springs(const StepSolution& step, int stage);
  void add_elements(const StepSolution& step, int stage);
  void add_forces(const StepSolution& step);
  void turn_columns(const Joint& joint, const std::vector<int>& dofs, int stage, const BallChart& chart);
  void set_balance(const Joint& joint, const std::vector<int>& dofs, int stage, const BallChart& chart);
  void turn_rows(const Joint& joint, const std::vector<int>& dofs, int stage, const BallChart& chart);
  void take_balls();

  const Tree* tree_;
  const DofPattern* pattern_;
  int stages_;
  bool with_nodes_;
  Stages values_;
  LocalTangent local_;
  ForceTangent field_;
  std::vector<int> balls_;  // joints
  std::vector<std::vector<int>> related_;
  std::vector<BallChart> charts_;  // [ball * stages + stage]
  MatX X_points_, v_points_;
  VecX q_, v_, dq_, dv_, df_;
};

}  // namespace contactvi

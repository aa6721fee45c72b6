// Constraints phi(q, t) = 0 and persistent contacts in a step of order 2s: impulses at its Lobatto nodes
// (base/lobatto.hpp) keep the configuration on them at these nodes and, at the end, the velocity.
//
// With X_k the displacement at node k, W_k the gradients there and Lambda_k the impulses along them,
//   P_i = p0 + h sum_j a_ij G_j + sum_k share_ik W_k Lambda_k,       phi(q0 (+) X_k, t0 + d_k h) = 0,  k = 1 .. s,
//   p1  = p0 + h sum_j b_j G_j + sum_k W_k Lambda_k,                 W_s^T M^-1 p1 + d phi/dt = 0.
// The first s impulses are found with the stage velocities: each iteration solves the linearised stage equations and
// conditions, with Newton's matrix of the former (stage_response.hpp; with one stage that of the mass matrix), the
// gradients as they are and, where contacts slide, the velocity at the end as a function of the unknowns. The last
// impulse is found after that. On spherical joints all of this stands in the chart, of whose gradients W_k are made
// (ball_chart.hpp).
//
// Rolling has rows without a phi: W(q_i)^T v_i = 0 at the stages instead, with impulses at the nodes as well, and at
// the end. The impulses of a sliding contact act along F_k = W_n - mu W_t d_k, d_k the direction of its slip at the
// node, which is an unknown, too: the slip across it is zero. Velocities at nodes inside of the step are those of the
// path raised by the velocities at both ends (path.hpp): those of the stages' polynomial alone would cost two orders
// where the slip turns.
//
// With one stage this is the midpoint rule in RATTLE form. Order 2s, symmetric, and symplectic without friction: Jay,
// "Specialized partitioned additive Runge-Kutta methods for systems of overdetermined DAEs with holonomic constraints",
// SIAM J. Numer. Anal. 45 (2007); "Lagrange-d'Alembert SPARK integrators for nonholonomic Lagrangian systems" (2009).
#pragma once

#include <memory>
#include <vector>

#include "base/reduction.hpp"
#include "step/anderson.hpp"
#include "step/path.hpp"
#include "step/raised_nodes.hpp"
#include "step/row_system.hpp"
#include "step/slip_projection.hpp"
#include "step/stage_nodes.hpp"
#include "step/stage_response.hpp"
#include "step/stiff_terms.hpp"

namespace contactvi {

class StageConstraints : private StageNodes {
 public:
  StageConstraints(const Tree& tree, int stages);

  // From the next step on these rows are kept as well; null: none.
  void hold(PhaseRows* rows);
  // Whether there is anything to keep.
  bool any() const { return rows_ > 0 || load_ != nullptr; }

  // The step of length h from (q0, p0), which begins at t0 [s]; equations: whose node is placed where it is needed.
  void begin(StepEquations& equations, const VecCRef& q0, const VecCRef& p0, double t0, double h, const VecX& tau);
  // Around begin(), where the step solved last began in the same state: this one, of so many times its length, starts
  // from what it found. True where its matrix is good enough.
  void keep_start();
  bool start_again(double ratio);
  // Before an iteration on the stages: the nodes to which their velocities lead, and what impulses there give them.
  void place_nodes(Stages& stages);
  // After it: changes the impulses, and with them the correction dv, the velocities and the errors of the stages.
  // factor: the matrix of the impulses is made anew.
  void correct(StepEquations& equations, Stages& stages, StiffTerms& stiff, bool factor);
  // Momentum that a step without impulses would have to begin with to end as this one, the impulse at its end left out.
  const VecX& start_momentum() const { return p_start_; }
  // The impulse at the end, of a step that leads to (q1, p1). False where the constraints are not met, or where a
  // prescribed motion jumps.
  bool close(StepEquations& equations, const Stages& stages, const VecCRef& q1, VecRef p1);

  // Energy of the corrections that rounding of the residuals makes [J].
  double rounding() const { return rounding_; }
  // The impulse of a row that rounding of its residuals makes, at most [N s; N m s].
  double impulse_rounding() const { return impulse_rounding_; }
  // Of a step that was not solved: looks which constraint its iterations were farthest from. Where even the shortest
  // step is not solved that is the reason: without constraints it is.
  void give_up();
  // The constraint that the last step could not satisfy, -1: none.
  int violated() const { return violated_; }
  // Of the last step, before the next one begins: its impulses along the rows of the constraints, their work, and how
  // much of this is done before the stages, in the mean [J].
  auto impulses() const { return sum_.head(fixed_); }
  double work() const { return work_; }
  double mean_work() const { return mean_work_ + 0.5 * load_work_; }
  // Of the rows of the phase: their impulses (count, s + 1) at the nodes; per sliding contact and node,
  // (slides, s + 1), the direction of its slip as an angle from the first tangent, and the slip along it [m/s].
  auto phase_impulses() const { return lambda_.bottomRows(rows_ - fixed_); }
  const MatX& slip_angles() const { return angles_; }
  // Those of all rows (rows, s + 1).
  const MatX& node_impulses() const { return lambda_; }
  const MatX& slips() const { return slips_; }
  // Their coefficients of friction.
  const MatX& slide_friction() const { return friction_; }
  // Work of the constant forces [J].
  double load_work() const { return load_work_; }
  const LobattoTable& table() const { return *table_; }
  // Of a force, its part at a node.
  double impulse_of(int node, double force) const { return h_ * table_->e[node] * force; }
  // The time of a node [s].
  double time_of(int node) const { return nodes_[static_cast<std::size_t>(node)].t; }
  // Whether rows share a load, so that their impulses are not the only ones that keep them.
  bool shares_load() const { return system_.is_redundant(); }
  // Whether sliding contacts do: then their impulses, of which any split keeps the rows, decide about the motion.
  bool slides_share_load() const;
  const VecX& end_velocity() const { return v1_; }

  // Mean forces of the rows in the last step, from which the next one starts: all that it depends on.
  const VecX& forces() const { return forces_; }
  void start_from(const VecX& forces) { forces_ = forces; }
  void forget() { forces_.setZero(rows_); }
  // The step just closed is taken: the next one starts from its forces.
  void accept() { forces_ = sum_ / h_; }

 private:
  // An unknown of the stage equations: the impulse of a row at a node, or the direction of a slip there.
  int unknowns() const { return rows_ * stages_ + slides_ * (stages_ - 1); }
  int unknown_at(int node, int row) const { return node * rows_ + row; }
  int direction_at(int node, int slide) const { return rows_ * stages_ + (node - 1) * slides_ + slide; }
  int node_of(int unknown) const;
  void aim_slips();
  void find_slips(StepEquations& equations, Stages& stages);
  void accelerate(Stages& stages, const VecX& du, const VecX& push);
  bool turned(int node, int slide) const { return turns_[static_cast<std::size_t>(node * slides_ + slide)] % 2 == 1; }
  void set_charts(const Stages& stages);
  template <class Visit>
  void each_chart(Visit visit) const;
  void turn(StagePanel& panel, int row, const Mat3& R) const;
  bool couple(StepEquations& equations, const Stages& stages);
  void respond(const StagePanel& given, Stages& stages, StiffTerms& stiff, StagePanel& rates, StagePanel& velocities);
  void end_rates(StepEquations& equations, const StagePanel& rates, StagePanel& momenta, MatX& found);
  void move_rows(const StagePanel& rates, const StagePanel& velocities, const MatX& end_rates, MatX& moved);
  void force_of(int unknown, VecRef force, VecRef chart) const;
  void make_matrix(StepEquations& equations, Stages& stages, StiffTerms& stiff);
  void scale_matrix();
  void add_to_residual(const Stages& stages);
  bool close_slides(StepEquations& equations, VecRef p1);
  bool keeps_phase() const;
  double slide_work(int k) const;
  void add_end_pull(VecRef p) const;

  MatX answers_;  // (slides, s + 1): what friction answers across the slip to a turn of its direction, <= 0
  // Per node and slide, how often the slip was found to have turned back, or not to have; odd: it has. Then it keeps
  // the direction of the node before it, so that the equations stay smooth beyond the place where the slip ends.
  std::vector<int> turns_;
  MatX to_nodes_;  // (s, s): velocities at the stages -> displacements at the nodes after the first, over h
  RaisedNodes raised_;
  StagePanel displaced_;  // of one node, (nv, columns)
  StepPath path_;
  MatX stage_rates_;
  VecX v_node_;
  MatX kept_lambda_, kept_angles_;
  std::vector<int> kept_turns_;
  bool kept_end_ = false;
  bool aims_ = false;  // before the first iteration on a step
  AndersonAcceleration acceleration_;
  double size_ = 0.0;           // squared, of the last correction by the same matrix; infinity: there is none
  bool changed_turns_ = false;  // since the matrix was made
  bool knows_end_ = false;      // whether v1_ is near the velocity at the end of this step
  // Of a unit of each unknown: the momenta that the stages get, and what these change of their rates and velocities.
  StagePanel given_, rates_, velocities_;
  std::vector<Mat3> charts_;  // inverse right Jacobians, of each spherical joint at each stage
  const VecX* tau_ = nullptr;
  std::unique_ptr<StageResponse> response_;  // with several stages
  bool coupled_ = false;                     // whether it could be factored
  VecX row_scale_, scale_, residual_, now_, change_;
  MatX matrix_;
  RowSystem system_;
  Reduction reduction_;
  SlipProjection slip_projection_;
  VecX forces_, sum_, v1_, q1_, p1_;
  double work_ = 0.0, mean_work_ = 0.0, load_work_ = 0.0;
  double rounding_ = 0.0, impulse_rounding_ = 0.0;
  int violated_ = -1;
};

}  // namespace contactvi

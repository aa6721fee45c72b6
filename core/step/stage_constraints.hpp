// Constraints phi(q, t) = 0 in a step of order 2s: impulses at its Lobatto nodes (base/lobatto.hpp) keep the
// configuration on them at these nodes and, at the end, the velocity.
//
// With X_k the displacement at node k, W_k the gradients there and Lambda_k the impulses along them,
//   P_i = p0 + h sum_j a_ij G_j + sum_k share_ik W_k Lambda_k,       phi(q0 (+) X_k, t0 + d_k h) = 0,  k = 1 .. s,
//   p1  = p0 + h sum_j b_j G_j + sum_k W_k Lambda_k,                 W_s^T M^-1 p1 + d phi/dt = 0.
// The first s impulses are found with the stage velocities: after each iteration on these, which leaves D dv = r, the
// impulses change by what the linearised conditions ask for, and the velocities with them. The last one is found after
// that. On spherical joints all of this stands in the chart, of whose gradients W_k are made (ball_chart.hpp).
//
// With one stage this is the midpoint rule in RATTLE form. Order 2s, symmetric and symplectic: Jay, "Specialized
// partitioned additive Runge-Kutta methods for systems of overdetermined DAEs with holonomic constraints", SIAM J.
// Numer. Anal. 45 (2007).
#pragma once

#include <Eigen/LU>
#include <Eigen/QR>
#include <vector>

#include "base/lobatto.hpp"
#include "base/reduction.hpp"
#include "model/placement.hpp"
#include "step/stages.hpp"
#include "step/step_equations.hpp"
#include "step/stiff_terms.hpp"

namespace contactvi {

class StageConstraints {
 public:
  StageConstraints(const Tree& tree, int stages);

  // The step of length h from (q0, p0), which begins at t0 [s].
  void begin(const VecCRef& q0, const VecCRef& p0, double t0, double h);
  // Before an iteration on the stages: the nodes to which their velocities lead, and what impulses there give them.
  void place_nodes(Stages& stages);
  // After it: changes the impulses, and with them the correction dv, the velocities and the errors of the stages.
  // factor: the matrix of the impulses is made anew.
  void correct(Stages& stages, StiffTerms& stiff, bool factor);
  // Momentum that a step without impulses would have to begin with to end as this one, the impulse at its end left out.
  const VecX& start_momentum() const { return p_start_; }
  // The impulse at the end, of a step that leads to (q1, p1); equations: whose node is placed there. False where the
  // constraints are not met, or where a prescribed motion jumps.
  bool close(StepEquations& equations, const Stages& stages, const VecCRef& q1, VecRef p1);

  // Energy of the corrections that rounding of the residuals makes [J].
  double rounding() const { return rounding_; }
  // Of a step that was not solved: looks which constraint its iterations were farthest from. Where even the shortest
  // step is not solved that is the reason: without constraints it is.
  void give_up();
  // The constraint that the last step could not satisfy, -1: none.
  int violated() const { return violated_; }
  // Of the last step, before the next one begins: its impulses along each row, their work, and how much of this is done
  // before the stages, in the mean [J].
  const VecX& impulses() const { return sum_; }
  double work() const { return work_; }
  double mean_work() const { return mean_work_; }
  // Mean forces of the rows in the last step, from which the next one starts: all that it depends on.
  const VecX& forces() const { return forces_; }
  void start_from(const VecX& forces) { forces_ = forces; }
  void forget() { forces_.setZero(rows_); }
  // The step just closed is taken: the next one starts from its forces.
  void accept() { forces_ = sum_ / h_; }

 private:
  struct Node {
    double t = 0.0;
    VecX q, X, phi, rate;
    MatX W, chart;  // gradients (nv, m), and those by the chart at the start of the step
    Placements at;
    explicit Node(const Tree& tree);
  };
  void place(Node& node);
  void add_impulses();
  void make_matrix(Stages& stages, StiffTerms& stiff);
  void factor_matrix();
  void solve_impulses();
  void set_charts(const Stages& stages);
  void to_stages(bool transposed, int S, double* x) const;
  void move_rows(const double* x, int S, VecRef moved);

  const Tree* tree_;
  const LobattoTable* table_;
  int rows_, stages_;
  VecX q0_, p0_, p_start_, impulse_;
  double h_ = 0.0;
  std::vector<Node> nodes_;  // s + 1
  MatX lambda_;              // (m, s + 1)
  MatX to_nodes_;            // (s, s): velocities at the stages -> displacements at the nodes after the first, over h
  MatX displaced_;           // (nv, s)
  // Per node k < s and row, all stages: what a unit impulse gives their momenta, and with D^-1 their velocities.
  std::vector<AlignedArray> given_, moved_;
  AlignedArray kept_, changed_;
  std::vector<Mat3> charts_;  // inverse right Jacobians, of each spherical joint at each stage
  VecX scale_, residual_, change_;
  MatX matrix_, used_matrix_;
  std::vector<int> used_;  // rows of the matrix that do something
  bool redundant_ = false;
  Eigen::PartialPivLU<MatX> lu_;
  Eigen::CompleteOrthogonalDecomposition<MatX> factor_;
  Reduction reduction_;
  VecX forces_, sum_, v1_;
  double work_ = 0.0, mean_work_ = 0.0;
  double rounding_ = 0.0;
  int violated_ = -1;
};

}  // namespace contactvi

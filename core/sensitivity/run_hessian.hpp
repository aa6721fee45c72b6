// Second derivatives of a function of a recorded run along one direction of its start and inputs: the gradient of
// RunAdjoint, and what it changes by along the direction. Forward along the direction once (StepTangent), which gives
// the changes of the states at the nodes; backward once, with the gradients and their changes (StepHessian,
// ImpactHessian).
//
// The time T of an event moves with the direction. With x = F(x0, T - t0) the state there, W the gradient of the gap,
// f = F_h, and the gradient l of the function in x and l_T in T, l + nu W with nu = -(l . f + l_T) / (W . f) is the
// gradient in x where T follows it: J = Phi(x, T) + nu gap(x) is stationary in T. Along the direction
//   dnu = -((dl + nu dW) . f + (l + nu W) . df + dl_T) / (W . f).
#pragma once

#include <functional>

#include "sensitivity/impact_hessian.hpp"
#include "sensitivity/piece_inputs.hpp"
#include "sensitivity/run_adjoint.hpp"
#include "step/public_hessian.hpp"
#include "step/step_hessian.hpp"

namespace contactvi {

// In the start (nv,) and in the inputs of all steps (steps, nv): a direction, a gradient, or the change of one. Public
// coordinates.
struct RunVector {
  VecX q, v;
  MatX tau;
};

struct RunCurvature {
  RunVector gradient, product;
};

class RunHessian {
 public:
  // Of the function: from changes (dq, dv) of the states at the nodes to its second derivative along them in
  // exponential coordinates, (nodes, nv) each.
  using CostHessian = std::function<void(const MatX& dq, const MatX& dv, MatX& hq, MatX& hv)>;

  RunHessian(const Scene& scene, const RecordedRun& run);

  // The product is the second derivative in exponential coordinates at the start. Throws NoDerivative.
  RunCurvature solve(const RunCost& cost, const CostHessian& hessian, const RunVector& direction);

 private:
  // Of a piece along the direction: its start and length, its stages' velocities and displacements, and its end before
  // the impact.
  struct PieceChange {
    VecX q, p;
    double h;
    MatX v, X;
    VecX q1, p1;
  };
  struct Node {  // engine coordinates
    VecX q, v, dq, dp;
  };
  void check() const;
  void check_forces_in_time(const Piece& piece);
  void check_impact(const Piece& piece) const;
  void forward(const RunCost& cost, const RunVector& direction);
  void keep_nodes(const RunCost& cost, double until, const VecX& q, const VecX& p, const VecX& dq, const VecX& dp);
  void set_direction(std::size_t piece, const RunVector& direction);
  void change_cost(const RunCost& cost, const CostHessian& hessian);
  void add_node(std::size_t node);
  void take_piece(const Piece& piece);
  double move_event(std::size_t piece, VecX& dq, VecX& dp);
  void pass_event(std::size_t piece, const RunVector& direction);
  void pass_piece(std::size_t piece, const RunVector& direction, RunCurvature& result);
  [[noreturn]] void refuse_step(const Piece& piece) const;

  const Scene* scene_;
  const RecordedRun* run_;
  Integrator integrator_;
  PieceInputs inputs_;
  StepHessian hessian_;
  Kinks kinks_{false};
  ImpactTangent impact_;
  ImpactHessian impact_second_;
  PublicHessian public_;
  StepDirection direction_;
  std::vector<PieceChange> changes_;
  std::vector<Node> nodes_;
  std::vector<MovingGradient> costs_;  // at the nodes, public coordinates
  // Where the backward pass is: the gradient in (q, p), and in the time at which the next piece starts.
  MovingGradient l_;
  DualNumber ltime_;
};

}  // namespace contactvi

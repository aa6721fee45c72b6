// The transposed derivative of a smooth step (q0, p0, h, forces) -> (q1, p1): from the gradient of some function in
// (q1, p1) to those in (q0, p0), h and the forces, at the cost of about one direction of StepTangent.
//
// mu_i are the multipliers of the stage equations r_i = 0 (lanes/lane_iteration.hpp). They give the gradients in the
// momenta P_i and forces G_i; with 1-dof and translation joints
//   P_bar_i = -mu_i,   G_bar_j = h (b_j lp + sum_i a_ij mu_i).
// P and G are the first derivatives of the Lagrangian in v and q, so their derivative is symmetric: the kernel's
// tangent along (dv, dq) = (P_bar, G_bar) gives the gradients v_bar in v as dP, and q_bar in q as dG. Only the second
// derivative in the turns of one spherical joint is not symmetric, by the bracket G x G_bar. mu makes
// v_bar_j + h (b_j lq + sum_i a_ij q_bar_i) vanish; it is found by the iterations of the step, mu += D^-T of that.
//
// Engine coordinates; gradients are dual to tangent vectors, which are body-fixed on spherical joints.
#pragma once

#include <Eigen/LU>
#include <vector>

#include "step/ball_adjoint.hpp"
#include "step/force_adjoint.hpp"
#include "step/solved_step.hpp"
#include "step/stage_force_rates.hpp"
#include "step/step_parameters.hpp"

namespace contactvi {

class StepAdjoint {
 public:
  StepAdjoint(const Tree& tree, int stages);

  // Takes a solved step: its start, length and forces, and the velocities at its stages, (nv, s).
  void take(const VecX& q0, const VecX& p0, double h, const VecX& tau, double time, const Servo* servo,
            const MatX& velocities);
  // From the gradient in (q1, p1) to those in (q0, p0), h, and the generalized force in public coordinates, (nv,)
  // each. source: gradients in the velocities of the stages from elsewhere, an array over dofs and stages; null: none.
  // False where the equations were not solved.
  bool solve(const VecCRef& lq, const VecCRef& lp, VecRef lq0, VecRef lp0, double& lh, VecRef ltau,
             const double* source = nullptr);
  // After solve(): adds what forces that depend on time give to the gradients in the time of the start and in h.
  void add_time(double& lt, double& lh);
  // Takes multipliers of the stage equations, (nv, s), that were found elsewhere, with the gradient in (q1, p1): for
  // add_parameters().
  void take_multipliers(const MatX& mu, const VecCRef& lq, const VecCRef& lp);
  // Of the momentum p = M(q) v: the gradients in q and v from that in p, (nv,).
  void momentum(const VecCRef& q, const VecCRef& v, const VecCRef& lp, VecRef lq, VecRef lv);
  // Adds the gradients in the parameters, after solve() or take_multipliers(); and those of the momentum p = M(q) v
  // from that in p.
  void add_parameters(StepParameters& sums);
  void add_momentum_parameters(const VecCRef& q, const VecCRef& v, const VecCRef& lp, StepParameters& sums);
  // Iterations of the last solve; 0: the matrix was factored.
  int iterations() const { return iterations_; }

 private:
  friend class StepHessian;  // goes the same way with numbers and their derivatives
  void set_seed(const VecCRef& lq, const VecCRef& lp);
  void sweep();
  bool iterate();
  bool solve_by_matrix();
  void finish(VecRef lq0, VecRef lp0, double& lh, VecRef ltau);
  double* shadow(double* array) { return array + stages_.work_.shadow; }
  void combine(const double* in, double* out) const;

  const Tree* tree_;
  SolvedStep step_;
  Stages stages_;  // the Lagrangian's part of P and G, and derivatives
  Stages node_;    // a single state, for momentum()
  ForceAdjoint forces_;
  StageForceRates rates_;
  ParameterAdjoint parameters_;
  std::vector<BallAdjoint> balls_;
  std::vector<char> in_ball_;  // per dof
  // h a_ij for sums over i, and h b_j with the padding lanes; per dof and stage: multipliers, gradients in G, in X,
  // sums, v_bar.
  AlignedArray weights_, hb_, mu_, px_bar_, G_bar_, X_bar_, sums_, v_bar_;
  VecX lq_, lp_;  // gradient in (q1, p1)
  const double* source_ = nullptr;
  int iterations_ = 0;
  bool has_matrix_ = false;
  Eigen::PartialPivLU<MatX> matrix_;
};

}  // namespace contactvi

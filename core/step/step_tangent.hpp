// The exact derivative of a smooth step (q0, p0, h, forces) -> (q1, p1) along directions: the tangent of the stage
// equations at their solution.
//
// The kernel's `tangent` evaluates the residual r(v; start) of the stage equations on dual numbers. With dv the
// derivative of the stage velocities, r_v dv = -r_start is solved by the iterations of the step itself, with its factor
// of the mass matrix: dv += D^-1 dr. The factor need not be exact, for it changes no digit of the solution. Where the
// iterations do not contract, the matrix r_v is made column by column and factored.
//
// Engine coordinates: tangent vectors are body-fixed on spherical joints.
#pragma once

#include <Eigen/LU>

#include "model/force_tangent.hpp"
#include "step/solved_step.hpp"
#include "step/stage_force_rates.hpp"
#include "step/step_parameters.hpp"

namespace contactvi {

// A direction in all that a step depends on; what is empty does not change.
struct StepDirection {
  VecX q, p;       // of the start, (nv,)
  double t = 0.0;  // of its time [s]
  double h = 0.0;  // of the step's length [s]
  VecX tau;        // of the generalized force, public coordinates (nv,)
  MatX impulses;   // of those that the stages receive besides, in the charts of spherical joints (nv, s)
  const StepParameters* parameters = nullptr;
};

class StepTangent {
 public:
  StepTangent(const Tree& tree, int stages);

  // Takes a solved step: its start, length and forces, and the velocities at its stages, (nv, s).
  void take(const VecX& q0, const VecX& p0, double h, const VecX& tau, double time, const Servo* servo,
            const MatX& velocities);
  // The step that was taken receives these impulses at its stages besides, in the charts of spherical joints (nv, s).
  void add_impulses(const MatX& impulses);
  // The derivative of (q1, p1) along a direction, (nv,) each. False where the equations were not solved.
  bool solve(const StepDirection& direction, VecRef dq1, VecRef dp1);
  // The solution of the last direction, by which the step has it again after others: the changes of the stages'
  // velocities and of their displacements, (nv, s) each.
  void keep(MatX& dv, MatX& dX) const;
  void resume(const StepDirection& direction, const MatX& dv, const MatX& dX);
  // After resume(), which takes any changes: what the stage equations are off by, stage by stage, (nv s,); and what the
  // end changes by.
  void residual(VecRef r) const;
  void finish(const StepDirection& direction, VecRef dq1, VecRef dp1);
  // Of the last direction: the change of the velocity at a stage, (nv,).
  void velocity_change(int stage, VecRef dv) const;
  // Of a step with one stage: what the momenta W, (nv, m), at its start change its end (Q, P) and its velocity V by,
  // all (nv, m). False if an equation was not solved.
  bool unit_changes(const Eigen::Ref<const MatX>& W, MatX& Q, MatX& P, MatX& V);
  // The tangent vector by which the configuration at a stage moves, (nv,).
  void configuration_change(int stage, VecRef dq) const;
  // The stages, and the change of an array of theirs (X, v, P or G with all forces).
  Stages& stages() { return stages_; }
  const double* change_of(const double* array) const { return shadow(array); }
  const SolvedStep& step() const { return step_; }
  // Of the last direction: the change of the step's discrete energy sum b_i E(q_i, v_i), of gravity, springs and
  // inertia alone [J].
  double energy_change() const;
  // dp of the momentum p = M(q) v along (dq, dv), (nv,).
  void momentum(const VecCRef& q, const VecCRef& v, const VecCRef& dq, const VecCRef& dv, VecRef dp);
  // Its derivative by q, (nv, nv).
  MatX momentum_changes(const VecCRef& q, const VecCRef& v);
  // Adds to dp what the momentum p = M(q) v changes by with the inertias.
  void add_momentum(const VecCRef& q, const VecCRef& v, const StepParameters& parameters, VecRef dp);
  // Iterations of the last solve; 0: the matrix was factored.
  int iterations() const { return iterations_; }

 private:
  void set_direction(const StepDirection& direction);
  void evaluate();
  bool iterate();
  bool solve_by_matrix();
  static void add_extra(void* self);
  void add_split_inputs();
  void add_ball_springs();
  void add_elements();
  void add_force_rates();
  void set_parameters();
  void add_parameters();
  Vec3 ball_turn(const Joint& joint, int stage) const;

  double* shadow(double* array) { return array + stages_.work_.shadow; }
  const double* shadow(const double* array) const { return array + stages_.work_.shadow; }

  const Tree* tree_;
  SolvedStep step_;
  Stages stages_;  // numbers and their derivatives
  Stages node_;    // a single state, for momentum()
  ForceTangent field_;
  StageForceRates rates_;
  ParameterTangent parameters_;
  MatX parameter_P_, parameter_G_;  // derivatives along the parameters at the stages, (nv, s)
  VecX q_, v_, dq_, dv_, df_, r_, dtau_;
  StepDirection direction_;  // of the last solution: what is asked for afterwards may outlive the caller's
  int iterations_ = 0;
  bool has_matrix_ = false;
  Eigen::PartialPivLU<MatX> matrix_;
};

}  // namespace contactvi

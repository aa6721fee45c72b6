// The stage equations of one step and their arrays, forces included: all that the kernel needs besides the tree.
//
// All stages of a Galerkin-Gauss step (Hairer, Lubich, Wanner, Geometric Numerical Integration, VI.6.2 and IX) on the
// configuration group; the equations are in lanes/lane_iteration.hpp. s = 1 is the midpoint rule.
#pragma once

#include <functional>
#include <limits>
#include <utility>
#include <vector>

#include "base/aligned_array.hpp"
#include "base/gauss.hpp"
#include "model/flat_model.hpp"
#include "model/forces.hpp"

namespace contactvi {

// References of servos at a time [s]: positions by dof and then velocities, (2 nv,).
using MovingReferences = std::function<VecX(double)>;

// Servos of joints with one degree of freedom, with the torques kp (q_ref - q) + kd (v_ref - v) + feed: during one
// control step, or in all steps with references that move within them.
struct Servo {
  bool any = false;
  VecX kp, kd, q_ref, v_ref, feed;  // nv
  // Not null: q_ref and v_ref are those of one time near the start of the step, from which these go on.
  const MovingReferences* moving = nullptr;
  // Of derivatives: joints whose force is that of a limit, whatever the inputs, gains and references are; empty: none.
  std::vector<char> held;
  bool holds(int dof) const { return !held.empty() && held[static_cast<std::size_t>(dof)] != 0; }
  // Sets q_ref and v_ref to moving references at a time.
  void refer(double t);
  // By how much the torque of a joint is that of references that have moved on, (2 nv,), and not of q_ref and v_ref.
  double lead(const VecX& references, int dof) const;
};

class Stages {
 public:
  // [rad] angle beyond which whole revolutions are taken off: the kernel's sine is accurate up to 1e6.
  static constexpr double kManyTurns = 1e4;

  // directions: along which the kernel takes derivatives; each doubles the arrays by their shadows (LaneWork).
  Stages(const Tree& tree, const FlatModel& model, int stages, int directions = 0);
  Stages(const Stages&) = delete;
  Stages& operator=(const Stages&) = delete;

  int count() const { return work_.s; }
  int padded() const { return work_.S; }
  const GaussTable& table() const { return *table_; }
  const LaneKernel& kernel() const { return *kernel_; }
  const Tree& tree() const { return *tree_; }

  // The step from (q0, p0) of length h; tau: generalized force in public coordinates, shape (nv,) or empty.
  void begin(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau);
  // Start time of the steps that begin from now on [s], and their servo; null: none.
  void set_time(double t) { t0_ = t; }
  void set_servo(const Servo* servo);
  double start_time() const { return t0_; }
  double time(int i) const { return t0_ + table_->c[i] * work_.h; }
  const Servo* servo() const { return servo_; }
  ForceField& field() { return field_; }
  const ForceField& field() const { return field_; }
  // Factors by which damping [s] and stiffness [s^2] enter the matrix of stage i.
  std::pair<double, double> shares(int i) const;
  // Whether there are forces that evaluate() does not know in the step that began.
  bool has_extra_forces() const { return work_.extra != nullptr; }
  // Impulses that the stages receive besides it, over dofs and stages, in the charts of spherical joints; at first
  // zero. With derivatives they have shadows as the other arrays have.
  double* impulse();
  // The steps that begin from now on receive none.
  void clear_impulse() { work_.impulse = nullptr; }
  // Replaces the start momentum of the step that began.
  void start_from(const VecCRef& p0);
  // Sets a configuration without a step, for functions of a single state.
  void at(const VecCRef& q0);

  void iterate(int flags) { kernel_->iterate(&model_->lanes, &work_, flags); }
  void evaluate() { kernel_->evaluate(&model_->lanes, &work_); }
  void place() { kernel_->place(&model_->lanes, &work_); }
  void factor() { kernel_->factor(&model_->lanes, &work_); }
  void solve() { kernel_->solve(&model_->lanes, &work_); }
  void rates() { kernel_->rates(&model_->lanes, &work_); }
  // X of the velocities; on spherical joints it depends on itself and is iterated until it stays.
  void settle();
  // X of spherical joints alone, until it changes by no more than this [rad].
  void settle_turns(double exact);
  // evaluate(), with all forces in G.
  void evaluate_with_forces();

  // Arrays over dofs and stages, [dof * padded() + stage].
  double* X() { return X_; }
  double* v() { return v_; }
  double* rate() { return work_.rate; }
  const double* rate() const { return work_.rate; }
  double* P() { return P_; }
  double* G() { return G_; }
  const double* P() const { return P_; }
  const double* G() const { return G_; }
  double* dv() { return dv_; }
  const double* dv() const { return dv_; }
  const double* storage() const { return storage_; }     // the factors among it
  const double* coupled() const { return coupled_; }     // and those of coupled joints
  const double* residual() const { return magnitude_; }  // that dv was solved from, after an iteration
  const double* v() const { return v_; }
  const double* X() const { return X_; }
  // Of the step's linear forces -stiffness (deflection + X) - damping v per dof; null: none.
  const double* stiffness() const { return work_.stiffness; }
  const double* damping() const { return work_.damping; }
  const double* deflection() const { return work_.deflection; }
  const double* hb() const { return hb_; }  // h b_j
  double length() const { return work_.h; }
  // Per stage: r . dv, P . v, and the energy of the impulses h f of the single forces f [J].
  double error(int i) const { return per_stage_[i]; }
  double kinetic(int i) const { return per_stage_[work_.S + i]; }
  double impulse_energy(int i) const { return per_stage_[2 * work_.S + i]; }
  void set_error(int i, double value) { per_stage_[i] = value; }

  // h sum_j b_j x_j of a stage array.
  double sum(const double* array, int dof) const;
  // Momentum of a spherical joint at the end of the step.
  Vec3 ball_end(const Joint& joint, const VecCRef& p0);
  // Torque of the servo of dof d at stage i [N; N m].
  double servo_torque(int d, int i) const;
  // Powers at stage i [W]: of inputs, servos and wrenches; taken by damping.
  double input_power(int i) const;
  double dissipation(int i) const;
  // Configuration at stage i.
  void configuration(const VecCRef& q0, int i, VecRef q);

 private:
  friend class StepTangent;  // these work on the arrays and their shadows
  friend class StepAdjoint;
  friend class LocalTangent;
  friend class StepHessian;
  friend class PublicHessian;
  friend class StageLanes;
  void allocate(int directions);
  void set_base(const VecCRef& q0);
  bool add_turns(const VecCRef& q0);
  // The derivatives of the base along a tangent vector dq, (nv,), so far after it in the arrays.
  void set_base_change(const VecCRef& dq, long shadow);
  void set_step(double h);
  void set_forces(const VecCRef& q0, const VecX& tau);
  static void add_extra(void* self);
  void add_forces();
  void add_split_inputs();
  void add_ball_springs();
  void add_elements();
  void add_lead();
  bool leads() const { return servo_ != nullptr && servo_->any && servo_->moving != nullptr; }

  const Tree* tree_;
  const FlatModel* model_;
  const GaussTable* table_;
  const LaneKernel* kernel_;
  LaneWork work_;
  AlignedArray memory_;  // all arrays below
  AlignedArray impulse_{0};
  double* moving_impulse_;    // with derivatives: in memory_; else null
  bool has_impulse_ = false;  // whether it was allocated
  double *X_, *v_, *rate_, *P_, *G_, *Y_, *px_, *dv_, *magnitude_, *diagonal_, *applied_, *storage_, *slots_, *coupled_;
  double *per_stage_, *hA_, *he_, *hb_, *base_, *ball_base_, *p0_, *stiffness_, *deflection_, *damping_, *input_;
  ForceField field_;
  const Servo* servo_ = nullptr;
  double t0_ = 0.0;
  VecX q0_, tau_, q_stage_, X_stage_, v_stage_, force_, size_;
  VecX element_input_, element_dissipation_;  // per stage
  MatX lead_;  // torques of servos because their references move, dofs x stages; used where there are such
  bool has_ball_springs_ = false, has_inputs_ = false;
  VecX turns_;  // per dof: of the lane's frame about the joint axis [rad]; empty where q has more numbers than v
  // Step lengths for which diagonal_ and the tableau hA_ were made; NaN: none.
  double diagonal_h_ = std::numeric_limits<double>::quiet_NaN(), tableau_h_ = 0.0;
};

}  // namespace contactvi

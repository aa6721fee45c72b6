// The equations of one smooth step of order 2s, and what their solution gives, apart from how they are solved: that is
// the part of Integrator and ImpulseStep.
//
// A step has stages inside of it and nodes at its ends. Functions of the state at a node alone (mass matrix, forces)
// stand here too, since they use the same kernel.
#pragma once

#include "model/placement.hpp"
#include "step/column_solver.hpp"
#include "step/stages.hpp"
#include "step/stiff_terms.hpp"

namespace contactvi {

struct StepCounters {
  long steps = 0, stage_iterations = 0, factorizations = 0;
};

class StepEquations {
 public:
  StepEquations(const StepEquations&) = delete;
  StepEquations& operator=(const StepEquations&) = delete;

  int stages() const { return stages_.count(); }
  const Tree& tree() const { return *tree_; }

  // Time at which the steps that are solved from now on start [s], and the servo that acts in them; null: none.
  void set_time(double t) { time_ = t; }
  void set_servo(const Servo* servo) { stages_.set_servo(servo); }
  double time() const { return time_; }
  const Servo* servo() const { return stages_.servo(); }
  ForceField& field() { return stages_.field(); }

  // End state of the step just solved.
  void finish(VecRef q1, VecRef p1);
  // X' and v at the stages of the step just solved, shape (nv, s).
  const MatX& rates();
  const MatX& velocities();
  // X' at the only stage, nv numbers; null where there are several.
  const double* only_rate() {
    if (stages_.padded() > 1) return nullptr;
    if (model_.lanes.balls > 0) stages_.rates();
    return stages_.rate();
  }
  // Their velocities, [dof * padded_stages() + stage].
  const double* stage_velocities() const { return stages_.v(); }
  int padded_stages() const { return stages_.padded(); }
  // Configuration and velocity at stage i of the step just solved.
  void stage_state(int i, VecRef q, VecRef v);
  // The part of the step after which it comes.
  double stage_place(int i) const { return stages_.table().c[i]; }
  // Torque of the servo of dof d at stage i of the step just solved [N; N m].
  double servo_torque(int d, int i) const { return stages_.servo_torque(d, i); }
  // Size of the highest mode of the stage velocities: what the polynomial of the path hardly resolves any more [m;
  // rad].
  double truncation() const { return highest_mode(stages_.v()); }
  // What the last iteration has changed of it, at most.
  double truncation_change() const { return highest_mode(stages_.dv()); }
  // Size of the displacements of the stages [m; rad].
  double stage_motion() const;

  // Of the step just solved [J]: work of inputs (wrenches and servos among them); what damping took; their difference
  // and its mean over the step; sum b_i E(q_i, v_i).
  double input_work() const;
  double damping_loss() const;
  double work() const { return input_work() - damping_loss(); }
  double mean_work() const;
  // Of the step just solved: what acts on each follower in it, its momentum at the start included [N s; N m s].
  VecX coupled_impulses() const;
  double discrete_energy();

  // v = M(q)^-1 p; the factor stays for solve_mass. False if M is not positive.
  bool node_velocity(const VecCRef& q, const VecCRef& p, VecRef v);
  // Makes the factor of M(q) for solve_mass and solve_masses.
  void place_node(const VecCRef& q);
  // x <- M^-1 x at the q of the last node_velocity or place_node.
  void solve_mass(VecRef x);
  // X <- M^-1 X there, shape (nv, m).
  void solve_masses(Eigen::Ref<MatX> X) { columns_.solve(node_, X); }
  // P = M v and G = dT/dq - dV/dq of gravity, shapes (nv,).
  void dynamics(const VecCRef& q, const VecCRef& v, VecRef P, VecRef G);
  // Where joints are coupled only S^T p of a momentum has a meaning for steps: p becomes M v, with the same S^T p.
  // False if M is not positive.
  bool complete_momentum(const VecCRef& q, VecRef p);

  StepCounters counters;

 protected:
  StepEquations(const Tree& tree, int stages);
  ~StepEquations() = default;

  // The step of length h from (q0, p0), which begins so much later than time(); tau: generalized force in public
  // coordinates, (nv,) or empty.
  void begin(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau, double after = 0.0);
  // Start values: the stages' velocities all v0, the charts of spherical joints at their origins.
  void start_constant(const VecCRef& v0);
  void clear_turns();
  // One iteration of the kernel on the stage equations (LaneFlags), with the stiff elements' share in its correction.
  void iterate_stages(int flags);
  void count_iteration(int flags);

  const Tree* tree_;
  FlatModel model_;
  Stages stages_, node_;
  StiffTerms stiff_;
  ColumnSolver columns_;
  VecX q0_, p0_;
  const VecX* momentum_ = &p0_;  // the momentum from which the end of the step follows
  double time_ = 0.0, h_ = 0.0;
  bool part_ = false;  // a part of a step: its sums are not continued
  // Digits that the sums of the last step lost, and those that the step just solved would lose.
  VecX carry_q_, carry_p_, next_carry_q_, next_carry_p_;

 private:
  void finish_all(VecRef q1, VecRef p1);
  double highest_mode(const double* v) const;
  template <class Value>
  double quadrature(Value value) const;

  Placements placements_;
  VecX q_stage_;
  MatX rates_, velocities_;
};

}  // namespace contactvi

// One smooth step of order 2s: solve the stage equations for the stage velocities, then q1 and p1.
//
// Sweeps correct the velocities with a factor of the mass matrix made in the first of them. They stop when the energy
// norm of the residual, relative to the motion's, times theta/(1 - theta) is below the tolerance, theta their
// measured contraction; or when rounding stops the contraction far below.
#pragma once

#include "model/placement.hpp"
#include "step/anderson.hpp"
#include "step/path.hpp"
#include "step/stages.hpp"
#include "step/start_values.hpp"
#include "step/stepper.hpp"
#include "step/stiff_terms.hpp"

namespace contactvi {

struct StepCounters {
  long steps = 0, stage_iterations = 0, factorizations = 0;
  long retries = 0;  // steps whose first start values did not converge
};

class Integrator final : public Stepper {
 public:
  // tol: see above; at most max_iterations per attempt.
  Integrator(const Tree& tree, int stages, double tol, int max_iterations);
  Integrator(const Integrator&) = delete;
  Integrator& operator=(const Integrator&) = delete;

  int stages() const override { return stages_.count(); }
  const Tree& tree() const { return *tree_; }

  // Time at which the steps that are solved from now on start [s]; what else pushes there, null: nothing.
  void set_time(double t) { time_ = t; }
  void set_servo(const Servo* servo) { stages_.set_servo(servo); }
  double time() const { return time_; }
  const Servo* servo() const { return stages_.servo(); }
  ForceField& field() { return stages_.field(); }

  // Torque of the servo of dof d at stage i of the step just solved [N; N m].
  double servo_torque(int d, int i) const { return stages_.servo_torque(d, i); }

  // Solve the step of length h from (q0, p0); tau: generalized force in public coordinates, (nv,) or empty. False
  // when the sweeps do not converge from any start; why() says it.
  bool solve(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) override;
  // The same to rounding, for what is differenced: impact maps.
  bool solve_closely(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau);
  // To rounding for the part alpha of a step whose path is known.
  bool solve_part(const StepPath& path, double alpha, const VecCRef& q0, const VecCRef& p0, const VecX& tau) override;
  // End state of the step just solved.
  void finish(VecRef q1, VecRef p1) override;
  // The step just finished is taken: the next one starts from its polynomial, and from the digits that its sums lost.
  void accept();
  // The next step starts elsewhere.
  void forget() override;
  // What the next step is started from, to go on from here later with the same digits.
  struct Memory {
    StartValues start;
    VecX carry_q, carry_p;
    std::vector<double> momenta;  // at the stages: the first sweep measures with them
    bool newton;
  };
  Memory memory();
  void recall(const Memory& memory);

  int stage_iterations() const { return stage_iterations_; }
  double residual_norm() const { return residual_; }
  const char* why() const override { return why_; }
  // X' at the stages of the step just solved, shape (nv, s).
  const MatX& rates() override;
  const MatX& velocities();  // v there
  // Size of the highest mode of the stage velocities: what the polynomial of the path hardly resolves any more [m;
  // rad].
  double truncation() const;

  // Of the step just solved [J]: work of inputs (wrenches and servos among them); what damping took; their difference
  // and its mean over the step; sum b_i E(q_i, v_i).
  double input_work() const;
  double damping_loss() const;
  double work() const { return input_work() - damping_loss(); }
  double mean_work() const;
  double discrete_energy();

  // v = M(q)^-1 p; the factor stays for solve_mass. False if M is not positive.
  bool node_velocity(const VecCRef& q, const VecCRef& p, VecRef v) override;
  // x <- M^-1 x at the q of the last node_velocity, or place_node.
  void solve_mass(VecRef x);
  // The same for the columns of X, (nv, m), as many at once as there are lanes.
  void solve_masses(Eigen::Ref<MatX> X);
  void place_node(const VecCRef& q);
  // P = M v and G = dT/dq - dV/dq of gravity, shapes (nv,).
  void dynamics(const VecCRef& q, const VecCRef& v, VecRef P, VecRef G);

  // A midpoint step whose start momentum is changed while it is solved, as contact impulses do (integrator_kicked.cpp).
  void begin_with_impulse(const VecCRef& q0, double h, const VecX& tau, const VecCRef& v);
  // One sweep with the start momentum p: v += D^-1 (p - p(v)), D the symmetric part of the step's Newton matrix, made
  // anew if factor. Returns the largest |change| of v; NaN if something is not finite.
  double iterate_with_impulse(const VecCRef& p, bool factor, bool first);
  // The start momentum that finish() takes.
  void start_with_impulse(const VecCRef& p) { p0_ = p; }
  // X <- D^-1 X, after a sweep that made D.
  void solve_with_impulse(Eigen::Ref<MatX> X);
  void add_velocity(const VecCRef& dv);
  void stage_velocity(VecRef v) const;

  StepCounters counters;

 private:
  bool iterate();
  bool converged(double error, double theta, bool accelerated) const;
  double relative_error() const;
  double energy() const;
  void begin(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau, double after = 0.0);
  template <class Value>
  double quadrature(Value value) const;
  void start_constant(const VecCRef& v0);
  bool start_by_ramp(const VecX& tau);
  bool turns_too_far();
  void solve_columns(Stages& stages, Eigen::Ref<MatX> X);

  const Tree* tree_;
  double tol_;
  int max_iterations_;
  FlatModel model_;
  Stages stages_, node_;
  StiffTerms stiff_;
  StartValues start_;
  Acceleration acceleration_;
  Placements placements_;
  VecX q0_, p0_, q_ramp_, p_ramp_, q_ramp1_, p_ramp1_, v0_, q_stage_;
  VecX carry_q_, carry_p_, next_carry_q_, next_carry_p_;
  MatX rates_, velocities_;
  double time_ = 0.0, h_ = 0.0, residual_ = 0.0, energy_scale_ = 0.0;
  int stage_iterations_ = 0;
  bool solved_ = false, part_ = false;
  bool newton_ = false;  // the last step needed the Newton matrix
  const char* why_ = "";
};

}  // namespace contactvi

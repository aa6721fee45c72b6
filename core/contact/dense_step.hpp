// The dense step: all impacts and contacts inside one step, without their times. It is taken where events accumulate.
//
// It is the step of persistent contact (contact_step.hpp) with impacts inside of it instead of located. Over the step h
// from q0 the candidates are the points of all pairs that may close within it; they keep their features over the step.
//   1. position impulse   p0 + W0^T L1 = smooth equation of v, q1 = q0 (+) h v,   0 <= L1_n _|_ phi(q1) >= 0, Coulomb
//   2. velocity impulse   over the closed ones, plastic: 0 <= L2_n _|_ w_n >= 0 at q1, Coulomb
//   3. restitution        contacts that closed fast: Poisson's expansion, an impulse of at least e (L1 + L2)_n
// Constraints are equations beside these laws (cone/reduced_solver.hpp): the position impulse closes them at q1,
// the velocity impulse their rates.
// Moreau, "Unilateral contact and dry friction in finite freedom dynamics", 1988; Acary, Brogliato, "Numerical methods
// for nonsmooth dynamical systems", 2008; nonsmooth RATTLE: Breuling, Capobianco, Eugster, Leine, 2024. It is of first
// order where impacts lie inside the step, of second where none do.
//
// Promised at every node, whatever the solver reached: impulses in the cone, gaps >= -1e-9 m against the simulated
// shapes, and an energy that rises by no more than the error of the step. A step that does not keep this is to be made
// again shorter (keeps_promises). The residual of Coulomb's law is reported.
#pragma once

#include <memory>
#include <vector>

#include "base/reduction.hpp"
#include "cone/problem_log.hpp"
#include "cone/reduced_solver.hpp"
#include "contact/dense_recorder.hpp"
#include "contact/dense_rows.hpp"
#include "model/friction_state.hpp"
#include "step/energy.hpp"
#include "step/impulse_step.hpp"

namespace contactvi {

// What a dense step has reached.
struct DenseReport {
  double residual = 0.0;      // of Coulomb's law, over the largest free speed of a contact (block_solver.hpp)
  double gap = 0.0;           // least gap at the end [m]
  double energy_rise = 0.0;   // how far the energy rose beyond energy_error and the works of inputs and damping [J]
  double energy_loss = 0.0;   // what contacts took: restitution and friction [J]
  double energy_error = 0.0;  // how much the energy may rise: the error of the step [J]
  int contacts = 0;           // that carried an impulse
  int repaired = 0;           // problems whose answer was repaired or blended
};

// What dense steps have cost, those that were made again shorter included.
struct DenseStepCounters {
  long problems = 0, sweeps = 0, factorizations = 0;  // of contact, Gauss-Seidel sweeps, factorizations for them
  long gap_iterations = 0, passes = 0;                // passes: that solved a step with the points known so far
};

class DenseStep {
 public:
  // [m] To which gaps of loaded contacts are zero at the end of a step, and of one that begins at rest: a few times
  // what the gaps are rounded by.
  static constexpr double kGapSolved = 1e-11, kGapSolvedAtRest = 1e-15;

  // tol: of the equations of steps; those of contact are solved to what belongs to 1e-12, and closer where it is less.
  DenseStep(const Scene& scene, Guards& guards, double tol = 1e-12);
  DenseStep(const DenseStep&) = delete;
  DenseStep& operator=(const DenseStep&) = delete;

  void set_time(double t) {
    t_ = t;
    integrator_.set_time(t);
  }
  // Length of a whole step, in which overlaps of rounding are closed [s]; a longer one counts as whole.
  void set_nominal(double h) { nominal_h_ = h; }
  void set_servo(const Servo* servo) { integrator_.set_servo(servo); }
  // Forgets the last step, from which the next one starts.
  void restart();
  // From now on what the derivatives of the steps need is kept.
  void keep_records() { recorder_ = std::make_unique<DenseRecorder>(*scene_, *guards_); }
  // From now on the contact problems of steps are kept there; null: no longer.
  void keep_problems(ProblemLog* log) { problems_ = log; }
  // Of the step just solved; its time and its share of the control step are left to the caller.
  DenseStepRecord& record() { return recorder_->record(); }

  // What has the last word where gaps and energy cannot both be kept. With kEnergy no point is pushed further than it
  // would be at rest, and gaps may stay below what is promised.
  enum class Kept { kGaps, kEnergy };

  // The step from (q0, p0). False only if the smooth equation is not solved or a number is not finite: why().
  bool solve(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau, Kept kept = Kept::kGaps);
  void finish(VecRef q1, VecRef p1) const;
  // The step is taken: the next one starts from its impulses, and the odometers of the guards advance.
  void commit();

  // Results of the step just solved.
  const std::vector<DenseContact>& contacts() const { return candidates_.contacts(); }
  const DenseReport& report() const { return report_; }
  const VecX& end_configuration() const { return q1_; }
  const VecX& stage_velocity() const { return v_; }
  const VecX& end_velocity() const { return v1_; }
  // Whether bodies may have passed through each other in the step, so that its gaps say nothing.
  bool passes_through() const { return candidates_.passes_through(); }
  // Whether gaps and energy are within what is promised.
  double allowed_rate() const { return candidates_.allowed_rate(); }
  bool keeps_promises() const { return candidates_.keeps_gaps() && report_.energy_rise <= 0.0; }
  // The pair or limit with the least gap at the end, -1: nothing overlaps.
  int deepest() const { return candidates_.deepest(); }
  double h() const { return h_; }
  double joint_friction_loss() const { return joint_friction_loss_; }
  double driven_work() const;
  // Impulses of the rows of the constraints in the step [N s; N m s].
  VecX constraint_impulses() const { return start_.mu + end_.mu; }
  const StepEquations& integrator() const { return integrator_; }
  const char* why() const { return why_; }
  // The constraint that the last step could not satisfy, -1: none.
  int violated_constraint() const { return violated_constraint_; }

  // All that the next step depends on.
  struct Memory {
    std::vector<DenseImpulse> impulses;
    VecX joint_friction;      // mean over the step [N; N m]
    std::vector<int> closed;  // guards of points that were closed at its end
    VecX change;              // of the velocity; empty: not known
    double h = 1.0;
  };
  const Memory& memory() const { return memory_; }
  void recall(const Memory& memory) { memory_ = memory; }
  DenseStepCounters counters;

 private:
  // The constraints at an end of the step: rows (nv, m), projected to the velocities of coupled joints and whole,
  // residuals, rates at fixed q, and impulses.
  struct Constraints {
    MatX W, whole;
    VecX phi, rate, mu;
  };
  bool constrained() const { return start_.phi.size() > 0; }
  bool fail(const char* why);
  void set_closeness();
  bool solve_smooth(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau);
  bool iterate_stage();
  void evaluate(const VecX& q, double t, Constraints& node);
  double hold_constraints();
  void set_start_momentum();
  double take_reactions();
  bool constraints_met();
  VecX momentum(const VecX& v) const;
  VecX multipliers(const VecX& dv, const VecX& lambda) const;
  bool masses_are_positive() const;
  void bound_velocities();
  bool position_impulses();
  bool position_problem();
  void set_slips();
  bool gap_iterations(double scale);
  double widest_loaded_gap() const;
  BlockOptions solver_options() const;
  double place_end();
  double offset(const DenseContact& c, std::size_t i) const;
  Vec3 end_tangent(const DenseContact& c);
  void set_friction();
  double follow_forces(bool half_way, double& speed);
  void settle_friction(double bound_energy, VecX& v, BlockResult& result);
  void set_pulls();
  void set_restitution(std::size_t i);
  bool closes_fast(const DenseContact& c) const;
  void pull_at_end();
  Eigen::Vector2d drift(const DenseContact& c, bool at_end);
  Vec3 turning_drift(const DenseContact& c, bool at_end);
  // First row of the turning friction of active contact k.
  int turning_row(std::size_t k) const { return rows_.block(rows_.block(k).turning).row; }
  bool any_surface_moves() const;
  double constraint_work() const;
  bool velocity_impulses(double bound_energy);
  void expand(double bound_energy);
  double contacts_error(const Energy& before, const Energy& free, const Energy& middle) const;
  void set_results(const VecX& lambda);
  double joint_friction_work(const VecX& lambda, const VecX& v) const;
  void note(const BlockResult& result);
  BlockResult solve_law(double bound_energy, VecX& v, const Constraints& node);
  void account(const BlockResult& result);

  const Scene* scene_;
  Guards* guards_;
  ProblemLog* problems_ = nullptr;
  ImpulseStep integrator_;
  ReducedSolver solver_;
  DenseCandidates candidates_;
  DenseRows rows_, end_rows_;     // end_rows_: of the contacts lasting_, for their slips
  std::vector<int> active_;       // contacts of the present problem; joint friction follows them
  std::vector<int> lasting_;      // those among them that were loaded in the last step; at the end, those that adhere
  std::vector<double> mobility_;  // of each of them along the normal [1/kg]
  // Of all contacts, as their coefficients were asked for last; and whether some of these depend on the forces.
  std::vector<FrictionState> friction_states_;
  bool follows_forces_ = false;
  Memory memory_;
  Constraints start_, end_;
  Reduction reduction_;  // of the constraints at the end of the step without contacts
  VecX q0_, q_free_, p0_, v0_, v_free_, v_, v1_, q1_, p1_;
  VecX p_start_, bound_, work_;  // momentum after the position impulse; bound on the velocities; workspace
  VecX pull_;                    // impulses of adhesion in the rows of the present problem; where adheres_
  bool adheres_ = false;         // anything in this step
  VecX lambda_, lambda_end_, joint_friction_;  // impulses of the present problem, of the end, of joint friction
  DenseReport report_;
  Kept kept_ = Kept::kGaps;
  std::unique_ptr<DenseRecorder> recorder_;
  // Shares of what is usually left, at most 1: as the tolerance asks for, and in this step.
  double usual_closeness_, closeness_ = 1.0;
  double gap_solved_ = 0.0;   // gaps of loaded contacts that count as zero in this step [m]
  double contraction_ = 1.0;  // of the iterations on the smooth equation
  double t_ = 0.0, h_ = 0.0, nominal_h_ = 0.0, joint_friction_loss_ = 0.0;
  int violated_constraint_ = -1;
  const char* why_ = "";
};

}  // namespace contactvi

// One smooth step of order 2s: solve the stage equations for the stage velocities, then q1 and p1.
//
// Stage iterations correct the velocities with a factor of the mass matrix made in the first of them. They stop when
// the energy norm of the residual, relative to the motion's, times theta/(1 - theta) is below the tolerance, theta
// their measured contraction; or when rounding stops the contraction near the solution.
#pragma once

#include <limits>
#include <memory>

#include "step/anderson.hpp"
#include "step/lane_company.hpp"
#include "step/path.hpp"
#include "step/stage_constraints.hpp"
#include "step/stage_iteration.hpp"
#include "step/start_values.hpp"
#include "step/step_equations.hpp"
#include "step/stepper.hpp"
#include "step/steps_ahead.hpp"

namespace contactvi {

class Guide;

class Integrator final : public Stepper, public StepEquations {
 public:
  // tol: relative error of the stage velocities, in the energy norm; at most max_iterations from each set of start
  // values. constrained: its steps keep the tree's constraints, if there are any, and the rows that it is told to hold.
  Integrator(const Tree& tree, int stages, double tol, int max_iterations, bool constrained = false);

  int stages() const override { return StepEquations::stages(); }
  // From the next step on these rows are kept as well; null: none.
  void hold(PhaseRows* rows);
  // Solves the step of length h from (q0, p0); tau: generalized force in public coordinates, (nv,) or empty. False
  // when the iterations do not converge from any start values; why() gives the reason.
  bool solve(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) override;
  // The next solve starts from where an earlier run has gone at the time t [s], the start of the step.
  void lead(Guide* guide, double t) {
    guide_ = guide;
    guide_time_ = t;
  }
  // From now on solve() gives a step up as soon as it is seen that its truncation is above this [m; rad].
  void limit_truncation(double limit) { truncation_limit_ = limit; }
  // Whether the last solve did so; truncation() is what it saw then.
  bool too_long() const { return too_long_; }
  // Displacement that the solution of the stage equations resolves in the step just solved [m; rad].
  double resolution() const { return iteration_.tol() * stage_motion(); }
  bool solve_closely(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) override;
  // Solves the part alpha of a step whose path is known, to rounding.
  bool solve_part(const StepPath& path, double alpha, const VecCRef& q0, const VecCRef& p0, const VecX& tau) override;
  // As this, to a tolerance.
  bool solve_part(const StepPath& path, double alpha, const VecCRef& q0, const VecCRef& p0, const VecX& tau,
                  double tol);
  void finish(VecRef q1, VecRef p1) override;
  const MatX& rates() override { return StepEquations::rates(); }
  bool node_velocity(const VecCRef& q, const VecCRef& p, VecRef v) override {
    return StepEquations::node_velocity(q, p, v);
  }
  double discrete_energy() override { return StepEquations::discrete_energy(); }
  double work() const override {
    return StepEquations::work() + (keeps_rows_ ? constraints_->work() + constraints_->load_work() : 0.0);
  }
  double mean_work() const override {
    return StepEquations::mean_work() + (keeps_rows_ ? constraints_->mean_work() : 0.0);
  }
  double length() const { return h_; }  // of the step just solved [s]
  // Those of the step just solved; null: it has none.
  const StageConstraints* constraints() const { return keeps_rows_ ? constraints_.get() : nullptr; }
  double modified_hamiltonian(double t, const VecCRef& q, const VecCRef& p, double h) override;

  // The step just finished is taken: the next one starts from its polynomial, and from the digits that its sums lost.
  void accept();
  // How far a spherical joint may turn in one step: up to there its chart is good [rad].
  static constexpr double kFarTurn = 3.5;
  // Steps of length h that are solved in advance from this state on, in which no other forces act than those of the
  // scene; 0: none. Where it is likely to be of use, they are solved now.
  int look_ahead(const VecCRef& q0, const VecCRef& p0, double h);
  const StepsAhead& ahead() const { return ahead_; }
  // Makes the one that comes so many steps after the next one the step just solved, for what is asked of that; accept:
  // and takes all steps up to it.
  void show_ahead(int after);
  void accept_ahead(int after);
  // The next step starts elsewhere.
  void forget() override;
  // Steps with one stage are solved side by side with those of other runs from now on; null: alone.
  void join(LaneCompany* company);
  // Nothing that was solved before counts any more: not even how well its iterations contracted.
  void start_anew();
  // What the next step starts from besides the state: with it a run goes on later with the same digits.
  struct Memory {
    StartValues::History start;
    VecX carry_q, carry_p;
    MatX momenta;  // at the stages, (stages, nv): the first iteration measures with them
    VecX constraint_forces;
    bool newton = false;
  };
  Memory memory();
  void recall(const Memory& memory);

  // Of the last solve.
  int stage_iterations() const { return stage_iterations_; }
  double residual_norm() const { return residual_; }
  const char* why() const override { return why_; }

 private:
  friend class LaneIterations;  // makes the iterations of several steps
  friend class LaneFlight;      // makes several steps of each
  // Steps that are solved in advance, where runs are made side by side.
  bool may_look_ahead(double h) const;
  void ask_ahead();
  bool take_ahead(const VecCRef& q0, const VecCRef& p0, double h);
  void count_ahead(int after);
  bool solve_stages();
  bool settles();
  void begin(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau, double after = 0.0);
  bool ends_well();
  bool limits_truncation() const { return truncation_limit_ < std::numeric_limits<double>::infinity(); }
  bool exceeds_truncation();
  void judge_iteration();
  void accelerate();
  bool start_by_ramp(const VecX& tau);
  bool turns_too_far();

  StageIteration iteration_;
  std::unique_ptr<StageConstraints> constraints_;  // null: its steps never keep any
  bool keeps_rows_ = false;                        // whether they do now
  VecX q1_, p1_;                                   // end of a step with constraints
  LaneCompany* company_ = nullptr;
  LaneIterations* lanes_ = nullptr;  // of the company
  StepsAhead ahead_;
  bool flies_ = false;       // its tree is one whose steps may be solved in advance
  bool asks_ahead_ = false;  // while it waits for that
  bool from_ahead_ = false;  // the step just solved was
  StartValues start_;
  Guide* guide_ = nullptr;  // of the next solve
  double guide_time_ = 0.0;
  AndersonAcceleration acceleration_;
  VecX v0_, iterate_, correction_, left_;
  MatX off_path_;
  bool keeps_factor_ = false;  // of the step that begins: the matrix of the one before is good enough for it
  double residual_ = 0.0;
  int stage_iterations_ = 0;
  bool solved_ = false;
  double truncation_limit_ = std::numeric_limits<double>::infinity();
  bool looks_at_truncation_ = false;  // whether it is unknown yet on which side of the limit it is
  bool too_long_ = false;
  bool newton_ = false;  // the last step needed the Newton matrix
  const char* why_ = "";
};

}  // namespace contactvi

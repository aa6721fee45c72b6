// Persistent contact: the midpoint step with unilateral constraints and Coulomb friction, in RATTLE form.
//
// Two impulses per step: the position impulse Lambda acts with W(q0) before it, the velocity impulse Lambda' with W(q1)
// after it,
//   p0 + W0^T Lambda = smooth equation of v, q1 = q0 (+) h v     0 <= Lambda_n _|_ phi(q1) >= 0
//   p1 = p^- + W1^T Lambda'                                      0 <= Lambda'_n _|_ w_n >= 0,  w = W1 M^-1 p1
// with Coulomb's law between Lambda_t and the slip s over the step, between Lambda'_t and w_t at its end: constraints
// at position level, velocities projected at the node (Hairer, Lubich, Wanner, Geometric Numerical Integration, VII.1,
// for bilateral constraints). The slip of a material point is its displacement on the support, counted from an anchor
// while it sticks, so that sticking contacts do not creep. The slip of rolling surfaces is W_t v, the mean of both
// ends. A contact that slipped keeps its direction of friction in the velocity impulse unless that would reverse its
// slip: the step is then of order 2 also where the direction of slip turns.
//
// Bilateral constraints phi(q, t) = 0 are rows without a cone: the position impulse makes phi(q1, t1) = 0, the velocity
// impulse makes the rate of phi zero at the node. They come first among the rows and are eliminated
// (base/reduction.hpp). Joint friction is a row with the bound f h/2 for each impulse, with an anchor where the joint
// sticks. Scenes with joint friction make all their steps here, with contacts or without, and so do scenes with
// constraints at order 2 and for derivatives; above that smooth steps keep them (step/stage_constraints.hpp).
#pragma once

#include <vector>

#include "base/extrapolation.hpp"
#include "base/interpolation.hpp"
#include "base/reduction.hpp"
#include "cone/problem_log.hpp"
#include "cone/solver.hpp"
#include "contact/contact_step_record.hpp"
#include "contact/friction_joint.hpp"
#include "contact/persistent_geometry.hpp"
#include "geometry/guard.hpp"
#include "model/constraints.hpp"
#include "model/friction_state.hpp"
#include "model/step_costs.hpp"
#include "step/impulse_step.hpp"
#include "step/stepper.hpp"

namespace contactvi {

struct ContactStepCounters {
  long steps = 0, contact_iterations = 0, problems = 0, iterations = 0, fallbacks = 0;
  double cost = 0.0;  // of all of it (step_costs.hpp)
};

class ContactStep final : public Stepper {
 public:
  // The step has an integrator of its own, with one stage, whose equations are solved to rounding.
  ContactStep(const Scene& scene, Guards& guards, const Manifolds& manifolds);
  ContactStep(const ContactStep&) = delete;
  ContactStep& operator=(const ContactStep&) = delete;

  std::vector<PersistentContact>& contacts() { return contacts_; }
  const std::vector<PersistentContact>& contacts() const { return contacts_; }
  // True if a step needs no impulses: there are no persistent contacts, constraints or joints with friction.
  bool empty() const { return contacts_.empty() && !has_fixed_rows(); }
  // Smooth steps keep constraints and joint friction as long as no contacts persist.
  void leave_fixed_rows_to_smooth_steps() { fixed_rows_alone_ = false; }
  bool constrained() const { return bilateral_ > 0; }
  // Whether constraints or joint friction make every step one of these.
  bool has_fixed_rows() const { return fixed_rows_alone_ && bilateral_ + friction_rows_ > 0; }
  void set_time(double t) { integrator_.set_time(t); }
  void set_servo(const Servo* servo) { integrator_.set_servo(servo); }
  // From now on the contact problems of steps are kept there; null: no longer.
  void keep_problems(ProblemLog* log) { problems_ = log; }
  // Nominal length of a step [s], over which errors of the constraints are corrected.
  void set_nominal(double h) { nominal_h_ = h; }
  // Whether `sticks` and `heading` of the contacts are those of their continuous forces, which smooth steps take for
  // granted; not after the contacts or the state have changed by other means.
  bool modes_known() const { return modes_known_; }
  void set_modes_known() { modes_known_ = true; }
  // To be called after contacts were added or released, or if the state is not the end of the last step.
  void invalidate() {
    leave();
    modes_known_ = false;
  }
  // The state is not the end of the last step.
  void leave() {
    node0_.known = follows_ = false;
    velocities_.clear();
    row_forces_.clear();
    shift_.resize(0);
    forget_parts();
    contraction_ = 1.0;
  }

  int stages() const override { return 1; }
  bool solve(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) override;
  bool solve_closely(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) override {
    return solve(q0, p0, h, tau);
  }
  bool solve_part(const StepPath& path, double alpha, const VecCRef& q0, const VecCRef& p0, const VecX& tau) override;
  void finish(VecRef q1, VecRef p1) override;
  void forget() override {}
  const char* why() const override { return why_; }
  const MatX& rates() override;
  // The velocity at the start of the step is known.
  bool node_velocity(const VecCRef& q, const VecCRef& p, VecRef v) override;

  // Sets the reason for which the caller rejects the step just solved.
  void reject(const char* why) { why_ = why; }

  // Results of the step just solved.
  double h() const { return h_; }
  const std::vector<ContactOutcome>& outcomes() const { return outcomes_; }
  const VecX& start_velocity() const { return v_start_; }
  const VecX& end_velocity() const { return v1_; }
  // The velocity at a state that is the end of the last step that was accepted; null: it is another one.
  const VecX* accepted_velocity(const VecX& q, const VecX& p) const {
    return follows_ && node0_.known && p == p1_ && q == node0_.q ? &v_node_ : nullptr;
  }
  // By how much the step may change the energy besides its work [J], but for rounding: see changes_energy.
  double energy_error(const VecCRef& p0, const VecCRef& p1);
  // Work of inputs, dissipation by damping and by joint friction, work of driven constraints [J].
  double input_work() const { return integrator_.input_work(); }
  double damping_loss() const { return integrator_.damping_loss(); }
  double joint_friction_loss() const;
  double driven_work() const;
  double friction_work() const;  // of contacts [J], <= 0; no part of work()
  double work() const override { return integrator_.work() + driven_work() - joint_friction_loss(); }
  // With all impulses at the start of the step done in the middle of it, and none of those at its end.
  double mean_work() const override;
  double discrete_energy() override;
  double modified_hamiltonian(double t, const VecCRef& q, const VecCRef& p, double h) override;
  // Position impulse plus velocity impulse of the rows of the constraints [N s; N m s].
  VecX constraint_impulses() const { return lambda_.head(bilateral_) + lambda_end_.head(bilateral_); }
  // For the start of a run: no joint has an anchor, and no forces are known.
  void restart();
  // The constraint that the last step could not satisfy, -1: none.
  int violated_constraint() const { return violated_constraint_; }
  // Whether a contact point runs so far in the step that its gap and its row at the start do not predict those at the
  // end: around a rim, or along two lines that are nearly parallel.
  bool rim_turns_far() const;
  bool runs_along_lines() const;
  // The step just solved, before commit(); what ended it is the caller's.
  ContactStepRecord record() const;
  // Accepts the step: stick and slip, anchors, forces and tangents become those of its end.
  void commit();

  // Per contact f_n - a_n / G_nn [N] at the end of the step just solved: f_n is the continuous normal force and a_n the
  // normal acceleration, of which one is zero. A contact with a negative value separates. False if the forces could not
  // be found.
  bool persistent_forces(const VecX& tau, VecX& value);
  // As persistent_forces, at a state (q, p) that is not the end of a step.
  bool persistent_forces_at(const VecCRef& q, const VecCRef& p, const VecX& tau, VecX& value);
  // The continuous forces at (q, v) and the time t [s], per row (n, t1, t2) of each contact, and the accelerations of
  // the rows with them. Contacts that slide do so along d: their slip, if it is one, with the sign of `directions`
  // (world), else that. equations: whose forces act.
  struct Forces {
    VecX f, a;             // of all rows
    double scale = 0.0;    // of f
    double largest = 0.0;  // acceleration without contacts
    double margin(int row, double mu) const { return mu * f[row] - f.segment<2>(row + 1).norm(); }
  };
  bool forces_at(StepEquations& equations, const VecCRef& q, const VecCRef& v, double t, const VecX& tau,
                 const std::vector<Vec3>& directions, Forces& out);
  // Of its rows: the first one of a contact, their Delassus matrix, and speeds and tangents of contact i.
  int row(std::size_t i) const { return row_[i]; }
  const MatX& force_matrix() const { return G_end_; }
  double force_normal_speed(std::size_t i) const { return w_end_[row_[i]]; }
  auto force_slip(std::size_t i) const { return w_end_.segment<2>(row_[i] + 1); }
  TangentFrame force_frame(std::size_t i) const { return frame(i, node1_); }
  int joint_row(std::size_t k) const { return bilateral_ + static_cast<int>(k); }
  VecX of_joints(const VecX& rows) const { return rows.segment(bilateral_, friction_rows_); }
  // Smooth steps have led to a state with this velocity.
  void follow(const VecX& v) { v1_ = v; }
  // Scale of the forces that the last call of persistent_forces found [N]: the largest of them, or the weight on a
  // contact if that is larger.
  double force_scale() const { return force_scale_; }
  // The coefficient of friction of a contact becomes that with which it sticks or slides at the time t [s].
  void set_coefficient(PersistentContact& c, double t) const {
    if (scene_->friction_varies(c.point.guard))
      c.mu = friction_of(*scene_, {c.point.guard, c.sticks, c.slip.norm(), c.force[0], t, c.mu});
  }
  // The coefficient of contact i with which forces_at found its force.
  double force_friction(std::size_t i) const { return force_cones_[friction_rows_ + i].mu; }
  // Slips are numbered: those of the contacts, then those of the joints with friction, then, where some contact has
  // friction against rolling, the rolling of the contacts. slip_ends: whether slip i came
  // to rest or reversed in the step. slip_at_start: its speed there. slip_left: its speed at the end of the step if the
  // friction had gone on, negative if the slip has reversed, -infinity where it has so for most of the step.
  int slips() const { return (rolling_ ? 2 : 1) * static_cast<int>(contacts_.size()) + friction_rows_; }
  bool slip_ends(int i) const;
  double slip_at_start(int i) const;
  double slip_left(int i) const;
  // Whether a contact may have separated, because its force in this step falls towards zero.
  bool may_release() const;

  const StepEquations& integrator() const { return integrator_; }
  const StepCounters& step_counters() const { return integrator_.counters; }
  ContactStepCounters counters;

  // Geometry and velocity rows of all contacts and constraints at a configuration.
  struct Node {
    bool known = false;
    double t = 0;
    MotionValues motions;
    VecX q, phi;  // residuals of the constraints
    // Velocities of the rows that are not those of the bodies: d phi/dt of constraints, of surfaces that move along
    // themselves; (rows,).
    VecX rate;
    std::vector<Contact> at;
    std::vector<Vec3> t1;
    std::vector<Vec3> side;              // of rims: direction from the centre to the contact point, world
    std::vector<Eigen::Vector2d> along;  // see Manifolds::place_along
    MatX W;                              // nv x rows
  };

  // The result of a step for a joint with friction; fields as in ContactOutcome.
  struct FrictionJointOutcome {
    bool slipped = false, slips = false, turned = false, keeps = false, freed = false;
    double reversed = 0;
  };

  // All that the next step depends on, so that a run that goes on from here has the same digits.
  struct Memory {
    std::vector<PersistentContact> contacts;
    std::vector<ContactOutcome> outcomes;
    Node node;
    std::vector<Vec3> reference_positions;
    std::vector<FrictionJoint> friction_joints;
    VecX fixed_force, v_node, v1, shift;
    Extrapolation::History velocities, row_forces;
    VecX p1;
    double contraction, nominal_h;
    bool follows, modes_known;
  };
  Memory memory() const;
  void recall(const Memory& memory);
  // Of the joints with friction only where they stick is a state.
  std::vector<FrictionJoint>& friction_joints() { return friction_joints_; }
  const std::vector<FrictionJoint>& friction_joints() const { return friction_joints_; }

 private:
  void set_rows();
  void constraint_node(const VecCRef& q, double t, Node& node, const MotionValues& motions = {});
  void set_constraint_velocities(double h);
  void start_joint_friction(const VecCRef& v);
  void classify_joint_friction(double speed);
  bool constraints_met(double h, bool rates);
  ConeContact joint_friction_cone(int k, double bound) const;
  // How well rows may agree that leave no choice, and the residual that is good enough; see ConeProblem.
  struct Agreement {
    double rough = 0.0, accept = 1e-9;
  };
  bool solve_rows(const std::vector<ConeContact>& cones, const MatX& G, const VecX& b, double noise, VecX& lambda,
                  bool regularize, const Agreement& agreement);
  double contact_matrix(int row, int column) const;
  bool has_slipped(int row, const Eigen::Ref<const VecX>& slip, double bound, double speed) const;
  bool roll_ends(std::size_t i) const;
  void classify_turning(std::size_t i, double speed);
  void set_turning_outcome(std::size_t i, double speed);
  void set_place(const ContactPoint& point, std::size_t i, Node& node) const;
  void set_contact_rows(std::size_t i, double t, Node& node);
  TangentFrame frame(std::size_t i, const Node& node) const {
    return guards_->frame(contacts_[i].point.guard, node.at[i], node.t1[i]);
  }
  void set_pulls(double h);
  void follow_slips(double h);
  double follow_forces(const VecX& impulses, double time, std::vector<ConeContact>& cones);
  bool solve_ends(VecX& lambda);
  void start_node(const VecCRef& q0);
  void end_node(const VecX& q1, double t1, const MotionValues& motions = {});
  bool iterate(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau, const VecX& v);
  bool turns_over() const;
  void note_shift(double h);
  void note_contraction(double second, double first, double rounding);
  void start_forces();
  void forget_parts();
  void note_part();
  void set_initial_impulses(double h);
  void set_row_velocities(double h);
  bool counts_by_rate(const PersistentContact& persistent, double h) const;
  bool counts_by_place(const FrictionJoint& joint, double h) const;
  Eigen::Vector2d slip_before(std::size_t i) const;
  void find_paradox();
  void find_jumps();
  double paradox_among_others(std::size_t i) const;
  double free_change(const VecCRef& p0, const VecCRef& p1);
  bool solve_cone(const ConeProblem& problem, VecX& lambda, bool regularize);
  bool velocity_impulses();
  bool solve_end(VecX& lambda);
  bool unfreeze_turned(const MatX& G, double still);
  void note_kept_directions(bool first);
  void set_outcomes();
  bool accelerations(StepEquations& equations, const VecCRef& q, const VecCRef& v, const VecX& tau);
  void set_force_rows(StepEquations& equations, const VecCRef& v);
  bool solve_forces(VecX& f);
  bool force_problem(VecX& value);
  void set_force_coefficients();

  const Scene* scene_;
  Guards* guards_;
  const Manifolds* manifolds_;
  PersistentGeometry geometry_;
  ProblemLog* problems_ = nullptr;
  ImpulseStep integrator_;
  ConeSolver solver_;
  const costs::Steps costs_;
  double residual_ = 0.0;  // of the last cone problem, 0 where it was solved
  std::vector<PersistentContact> contacts_;
  std::vector<ContactOutcome> outcomes_;
  std::vector<int> row_;                        // first row of each contact
  std::vector<ConeContact> cones_, end_cones_;  // of the joints with friction, then of the contacts
  std::vector<int> active_;                     // contacts that take part in the velocity impulse
  std::vector<int> sub_rows_;
  std::vector<FrictionJoint> friction_joints_;
  std::vector<FrictionJointOutcome> friction_outcomes_;
  Reduction reduction_;
  int bilateral_ = 0, friction_rows_ = 0;  // rows of constraints, of joint friction; those of the contacts follow
  int violated_constraint_ = -1;
  bool fixed_rows_alone_ = true;
  VecX fixed_force_;  // of the rows of constraints and joint friction in the last step
  int rows_ = 0;
  bool rolling_ = false;   // whether some contact has friction against rolling
  bool iterated_ = false;  // whether the gap of some contact is the end of Newton's method, which rounds more
  Node node0_, node1_;
  std::vector<double> paradox_;  // A of each contact (ContactOutcome)
  std::vector<Vec3>
      reference_positions_;  // positions of material points in the plane's body frame, from which slip counts
  bool adheres_ = false, friction_varies_ = false;  // whether some contact does, whether that of some contact does
  bool follows_forces_ = false;                     // whether that of some contact depends on its normal force
  std::vector<FrictionState> friction_states_;      // of the contacts, as their coefficients were asked for last
  VecX pull_, pull_end_;  // impulses of adhesion along the rows, in the step's first half and its second one [N s]
  VecX y_, lambda_, lambda_end_, b_, change_, v_, p_start_, p_minus_, p_given_, q1_, p1_, v1_, dv_;
  MatX DinvW_, S_, G_, MinvW_, right_sides_, G_end_, G_sub_, rates_;
  VecX b_sub_, x_, rest_;
  std::vector<ConeContact> force_cones_;
  VecX w_end_, guess_, q_side_, acceleration_;
  VecX v_start_;          // velocity at the start of the step just solved
  VecX v_node_;           // velocity at the end of the last step
  bool follows_ = false;  // the state is the end of the last step
  bool modes_known_ = false;
  // Of the last steps, one after the other: the velocities in their middle, and the position impulses of all rows over
  // their length [N; N m].
  Extrapolation velocities_, row_forces_;
  // Of the parts of the step under way that were solved, by their lengths [s], the same.
  Interpolation part_velocities_, part_forces_;
  bool shows_part_ = false;   // all results are those of the part of length h_
  double contraction_ = 1.0;  // of the first iteration of a step with these contacts, as seen last; 1: unknown
  // Of the rows: forces from which iterations start, those to which they have led, and what contact problems whose
  // impulses are not unique start from besides (ConeSolver::shift).
  VecX start_forces_, solved_forces_, shift_;
  double h_ = 0, nominal_h_ = 0, force_scale_ = 0;
  const char* why_ = "";
};

}  // namespace contactvi

// Lasting contact: the midpoint step with unilateral constraints and Coulomb friction, in RATTLE form.
//
// Two impulses per step, one with W(q0) before it, one with W(q1) after it:
//   p0 + W0^T Lambda = smooth equation of v, q1 = q0 (+) h v     0 <= Lambda_n _|_ phi(q1) >= 0
//   p1 = p^- + W1^T Lambda'                                      0 <= Lambda'_n _|_ w_n >= 0,  w = W1 M^-1 p1
// with Coulomb's law between Lambda_t and the slip s over the step, between Lambda'_t and w_t at its end: constraints
// at position level, velocities projected at the node (Hairer, Lubich, Wanner, Geometric Numerical Integration, VII.1,
// for bilateral constraints). The slip of a point fixed to a body is its displacement on the support, from an anchor
// where it stuck: no creep. That of rolling surfaces is W_t v, the mean of both ends. A contact that slipped keeps its
// direction of friction in the end kick unless that would turn its slip round: order 2 for turning slip.
//
// Constraints phi(q, t) = 0 are rows of the same kind without a cone: phi(q1, t1) = 0 by the first impulse, its rate 0
// at the node by the second. They come first among the rows and are eliminated (reduction.hpp). Dry friction of joints
// are rows with a bound f h/2 for each impulse, from an anchor where the joint sticks. Such scenes make all their steps
// here, with contacts or without.
#pragma once

#include <vector>

#include "base/reduction.hpp"
#include "cone/solver.hpp"
#include "contact/contact_point.hpp"
#include "geometry/guard.hpp"
#include "step/integrator.hpp"

namespace contactvi {

struct ContactStepCounters {
  long steps = 0, contact_iterations = 0, problems = 0, iterations = 0, fallbacks = 0;
};

class ContactStep final : public Stepper {
 public:
  // integrator: one stage, of its own.
  ContactStep(const Scene& scene, Guards& guards, const Manifolds& manifolds, double tol);
  ContactStep(const ContactStep&) = delete;
  ContactStep& operator=(const ContactStep&) = delete;

  std::vector<PersistentContact>& contacts() { return contacts_; }
  const std::vector<PersistentContact>& contacts() const { return contacts_; }
  // Whether steps need no impulses at all.
  bool empty() const { return contacts_.empty() && bilateral_ + friction_rows_ == 0; }
  bool constrained() const { return bilateral_ > 0; }
  void set_time(double t) { integrator_.set_time(t); }
  void set_servo(const Servo* servo) { integrator_.set_servo(servo); }
  // Usual length of a step: what the gaps are off is taken back over it.
  void set_nominal(double h) { nominal_h_ = h; }
  // Contacts were added or dropped, or the state is not the end of the last step.
  void changed() { node0_.known = follows_ = false; }

  int stages() const override { return 1; }
  bool solve(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) override;
  bool solve_part(const StepPath& path, double alpha, const VecCRef& q0, const VecCRef& p0, const VecX& tau) override;
  void finish(VecRef q1, VecRef p1) override;
  void forget() override {}
  const char* why() const override { return why_; }
  const MatX& rates() override;
  bool node_velocity(const VecCRef& q, const VecCRef& p, VecRef v) override {
    return integrator_.node_velocity(q, p, v);
  }

  void refuse(const char* why) { why_ = why; }

  // Of the step just solved.
  double h() const { return h_; }
  const std::vector<ContactOutcome>& outcomes() const { return outcomes_; }
  const VecX& end_velocity() const { return v1_; }
  // Of inputs, what damping took, what the dry friction of joints took, of driven constraints [J].
  double input_work() const { return integrator_.input_work(); }
  double damping_loss() const { return integrator_.damping_loss(); }
  double joint_friction_loss() const;
  double driven_work() const;
  double work() const { return integrator_.work() + driven_work() - joint_friction_loss(); }
  // Impulses of the constraints' rows in both kicks [N s; N m s].
  VecX constraint_impulses() const { return lambda_.head(bilateral_) + lambda_end_.head(bilateral_); }
  // What starts from rest: no joint sticks anywhere yet.
  void restart();
  // Constraint that the last step could not meet, -1: none.
  int unmet() const { return unmet_; }
  // Whether the contact of a rim runs round so far in the step that its start says nothing of its end.
  bool swings() const;
  // The step is taken: modes, anchors, forces and tangents become those of its end.
  void commit();

  // Forces that would hold the contacts at the end of the step just solved, against what separates them: per contact
  // f_n - a_n / G_nn, f_n the continuous normal force, a_n the normal acceleration, one of which is zero [N]. A contact
  // whose value is negative leaves. False if it could not be found.
  bool persistent_forces(const VecX& tau, VecX& value);
  // The same at (q, p), of which no step is known.
  bool persistent_forces_at(const VecCRef& q, const VecCRef& p, const VecX& tau, VecX& value);
  // Size of the forces that the last persistent_forces could have met: gravity's weight on a contact, or the largest
  // of them [N].
  double force_scale() const { return force_scale_; }
  // Slips of the contacts, then those of the joints with dry friction: whether one came to rest or turned round in the
  // step, and the speed that is left of it at the end as if the friction had gone on, negative if that has turned.
  int slips() const { return static_cast<int>(contacts_.size()) + friction_rows_; }
  bool slip_ends(int i) const;
  double slip_left(int i) const;
  // Whether a contact may have left: its forces of this step fall towards zero.
  bool may_release() const;

  const Integrator& integrator() const { return integrator_; }
  const StepCounters& step_counters() const { return integrator_.counters; }
  ContactStepCounters counters;

  // Geometry and velocity rows of all contacts at a configuration.
  struct Node {
    bool known = false;
    double t = 0;
    VecX q, phi, rate;  // residuals of the constraints and their rates at fixed q
    std::vector<Contact> at;
    std::vector<Vec3> t1;
    std::vector<Vec3> side;  // of rims: where their contact lies
    MatX W;                  // nv x rows
  };

  // Dry friction of a joint.
  struct FrictionJoint {
    int dof, iq;  // iq: -1 if it has more than one number in q
    double limit;
    bool anchored = false;
    double anchor = 0, reference = 0;
    double speed = 0;  // at the start of the step; 0 where it sticks
  };
  // What a step did to it; as ContactOutcome.
  struct FrictionJointOutcome {
    bool slipped = false, slips = false, turned = false;
    double reversed = 0;
  };

  // What the next step is started from, to go on from here later with the same digits.
  struct Memory {
    std::vector<PersistentContact> contacts;
    std::vector<ContactOutcome> outcomes;
    Node node;
    std::vector<Vec3> y_ref;
    std::vector<FrictionJoint> friction_joints;
    VecX fixed_force, v_node, v_last, v1;
    double h_last, nominal_h;
    bool follows;
  };
  Memory memory() const;
  void recall(const Memory& memory);

 private:
  void set_rows();
  void constraint_node(const VecCRef& q, double t, Node& node);
  void measure_constraints(double h);
  void start_joint_friction(const VecCRef& v);
  void judge_joint_friction(double speed);
  bool constraints_met(double h, bool rates);
  int find_jump(double h) const;
  ConeContact joint_friction_cone(int k, double bound) const;
  bool solve_rows(const std::vector<ConeContact>& cones, const MatX& G, const VecX& b, double noise, VecX& lambda,
                  bool regularize, double rough = 0.0);
  double contact_matrix(int row, int column) const;
  void start_node(const VecCRef& q0);
  void end_node(const VecX& q1, double t1);
  void evaluate(const PersistentContact& persistent, Contact& contact);
  Vec3 tangent_at(const PersistentContact& persistent, const Contact& contact, const Contact& before,
                  const Vec3& t1) const;
  Vec3 place_on_plane(const ContactPoint& point) const;
  bool iterate(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau, const VecX& v);
  void start_impulses(double h);
  void measure(double h);
  double shortest_place(const PersistentContact& persistent) const;
  void find_paradox(const VecX& v);
  bool solve_cone(const ConeProblem& problem, VecX& lambda, bool regularize);
  bool velocity_impulses();
  bool solve_end(VecX& lambda);
  bool unfreeze_turned(const MatX& G, double still);
  void describe();
  bool accelerations(const VecCRef& q, const VecCRef& v, const VecX& tau);
  bool force_problem(VecX& value);

  const Scene* scene_;
  Guards* guards_;
  const Manifolds* manifolds_;
  Integrator integrator_;
  ConeSolver solver_;
  double tol_;
  std::vector<PersistentContact> contacts_;
  std::vector<ContactOutcome> outcomes_;
  std::vector<int> row_;                        // first row of each contact
  std::vector<ConeContact> cones_, end_cones_;  // of the dry friction first, then of the contacts
  std::vector<int> active_;                     // contacts of the end kick
  std::vector<int> sub_rows_;
  std::vector<FrictionJoint> friction_joints_;
  std::vector<FrictionJointOutcome> friction_outcomes_;
  Reduction reduction_;
  int bilateral_ = 0, friction_rows_ = 0;  // rows of constraints, of dry friction; those of the contacts follow
  int unmet_ = -1;
  VecX fixed_force_;  // of these rows in the last step
  int rows_ = 0;
  bool redundant_ = false, noisy_ = false;
  Node node0_, node1_;
  std::vector<double> paradox_;  // A per contact, 1 where it does not apply
  std::vector<Vec3> y_ref_;      // where the material points are on their planes, or were when they stuck
  VecX y_, lambda_, lambda_end_, b_, change_, v_, p_start_, p_minus_, q1_, p1_, v1_, dv_;
  MatX DinvW_, S_, G_, MinvW_, G_end_, G_sub_, rates_;
  VecX b_sub_, x_, rest_;
  std::vector<ConeContact> force_cones_;
  VecX w_end_, guess_, q_side_, v_side_, acceleration_;
  VecX v_node_, v_last_;  // of the last step: at its end, in its middle
  double h_last_ = 1;
  bool follows_ = false;  // the next step is the one after it
  double h_ = 0, nominal_h_ = 0, force_scale_ = 0;
  const char* why_ = "";
};

}  // namespace contactvi

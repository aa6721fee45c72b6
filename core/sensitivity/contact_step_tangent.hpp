// The derivative of one step with persistent contacts, with the contacts that were loaded, stuck and slipped in it.
//
// The position impulse Lambda acts before the smooth step, whose derivative is T (StepTangent):
//   dp_start = dp0 + dW0 Lambda + W0 dLambda,   (dq1, dp-) = T(dq0, dp_start, dh)
// and dLambda follows from the rows of the contacts: the gap of a loaded one and the slip of one that sticks stay zero,
// friction keeps to Coulomb's law d(Lambda_t + mu Lambda_n s / |s|) = 0, an open contact has no impulse; constraints
// come first among the rows, and stay satisfied also where the times of the step's ends move. The velocity
// impulse follows in the same way from w = W1^T M^-1 p1 at the end. Where several points share a load, the impulses are
// those of least norm, and the derivative exists if the motion does not depend on how the load is shared.
//
// Surfaces that move along themselves have velocities of their own in the slips, which change with the configuration
// and the time. Friction that depends on the speed is that of the slip over the step in both problems,
// d mu = mu' s . ds / |s|. Adhesion takes from the impulses of the normals half of its own at each end. Friction
// against spinning and rolling has rows of its own (friction_rows.hpp), with the same law.
//
// Friction and slip are compared in the frames of tangents (n, t1, t2) at both ends. Only how these frames turn against
// each other matters: t1 at the start turns with its normal by the shortest turn, or with the plane that it is fixed
// to, and t1 at the end follows from it as in the step.
#pragma once

#include "contact/contact_step_record.hpp"
#include "geometry/contact_tangent.hpp"
#include "geometry/surface_velocity_tangent.hpp"
#include "model/constraint_tangent.hpp"
#include "sensitivity/friction_rows.hpp"
#include "sensitivity/kinks.hpp"
#include "sensitivity/recorded_run.hpp"
#include "sensitivity/shared_load.hpp"
#include "step/integrator.hpp"
#include "step/step_tangent.hpp"

namespace contactvi {

// A direction in all that a contact step depends on; what is empty does not change.
struct ContactStepDirection {
  VecX q, p;                // of the start, (nv,)
  double t = 0.0, h = 0.0;  // time of the start, of which constraints may be functions, and length
  VecX tau;                 // public coordinates, (nv,)
  VecX mu;                  // of the contacts
  MatX anchors;             // of the contacts that have one, in the frames of their planes, (3, contacts)
  VecX joints;              // anchors of the joints with friction
  const StepParameters* parameters = nullptr;
  double size_q = 0.0, size_p = 0.0;  // largest change of q and p on the way: rounding is relative to it
};

class ContactStepTangent {
 public:
  ContactStepTangent(const Scene& scene, Kinks& kinks);

  // Takes a step with its inputs; it is to stay alive. Throws NoDerivative.
  void take(const ContactStepRecord& step, const VecX& tau, const Servo* servo);
  // The derivative of (q1, p1), (nv,) each.
  void solve(const ContactStepDirection& direction, VecRef dq1, VecRef dp1);
  // Of the last direction: that of the slip whose end ended the step, if its friction had gone on [m/s].
  double slip_change() const { return slip_change_; }
  // Whether the step ended where that slip came to rest: one that was at rest before it tells no time.
  bool slip_ends() const { return slip_ends_; }
  // Of the last direction, without parameters: the changes of the scalar that DTEC conserves, of a step after an impact
  // and of one before it [J]. It is the discrete energy less the work that prescribed motions do at the start of the
  // step, or plus the work that they do at its end.
  double energy_change_after();
  double energy_change_before();
  // The change of the place of a contact's material point in the frame of its plane, where q1 changes by dq1.
  Vec3 place_change(int contact, const VecX& dq1);
  // Distance from the nearest change of what is loaded, sticks or slips, relative to the impulses or the speeds.
  double margin() const { return margin_; }

 private:
  friend class ContactStepAdjoint;                  // its transpose, from the same parts
  enum class Mode { kOpen, kStick, kKept, kSlip };  // kKept: slips along a given direction
  // A coefficient of friction, with its derivatives by the slip over the step, by the force that an impulse is over
  // half of the step, and by the time.
  struct Coefficient {
    double mu = 1.0, by_slip = 0.0, by_normal = 0.0, by_time = 0.0;
  };
  // The friction of a contact in the step.
  struct Friction {
    std::size_t contact;
    FrictionRows rows;
    int normal;  // the row of the normal
    // Its coefficients in the position impulse, in the velocity impulse, and in this if the slips had gone on.
    Coefficient start, end, frozen;
    VecX slip;          // over the step; 0: it did not slip
    bool slipped;       // during the step,
    bool directed;      // with friction against that slip,
    bool slips, keeps;  // at its end, as of a ContactOutcome
    bool freed, turned;
  };
  // Of the position impulse or of the velocity impulse: what the joints, contacts and their friction do, the impulses,
  // the speeds of the rows, and the equations for the changes of the impulses.
  struct Problem {
    std::vector<Mode> joints;
    std::vector<char> open;  // contacts
    std::vector<Mode> frictions;
    VecX lambda, w;
    SharedLoad system;
  };
  // In the velocity impulse: whether its friction keeps its direction, or would reverse it beside others that all keep
  // theirs; lasts: it was there over the step.
  struct EndedSlip {
    bool keeps, freed, lasts;
  };

  [[noreturn]] void refuse(const char* reason, int guard, const std::string& fact, const char* expected,
                           const std::string& got, const char* remedy) const;
  // An obstacle that is a kink.
  void meet(const char* reason, int guard, const std::string& fact, const char* expected, const std::string& got,
            const char* remedy) const;
  double energy_change();
  bool follows_slip(const Friction& friction, double mu, const VecX& lambda, const VecX& slip) const;
  Coefficient coefficient(const Friction& friction, double normal_impulse) const;
  const Coefficient& of(const Problem& problem, const Friction& friction) const {
    return &problem == &position_ ? friction.start : &problem == &velocity_ ? friction.end : friction.frozen;
  }
  double force_of(const Problem& problem, const Friction& friction) const {
    return 2.0 * problem.lambda[friction.normal] / record_->h;
  }
  double follow_frozen_forces();
  void add_friction(std::size_t contact);
  void meet_limit_of_friction(int guard) const;  // -1: of a joint
  void take_contacts();
  void take_laws();
  void take_position_problem();
  void set_laws(Problem& problem, const MatX& rows);
  void check_shared(const Problem& problem, const MatX& effect) const;
  VecX law_change(const Problem& problem, const ContactStepDirection& d, const VecX& base, const VecX& dy) const;
  void solve_laws(const Problem& problem, const VecX& c, const VecX& size, VecX& dlambda) const;
  VecX slip_of(const Problem& problem, std::size_t friction) const;
  int ended_joint() const;
  const Friction& ended_friction() const;
  void turn_tangents(const ContactStepRecord::Contact& contact, double about, const MatX& W, const VecX& own, MatX& dW,
                     VecX& down) const;
  EndedSlip ended_slip() const;
  void take_released_friction();
  void check_laws();
  // Impulses along the rows at an end, less those of adhesion, and the changes of these.
  VecX given(const VecX& lambda, int end) const { return lambda - pull_[end]; }
  VecX pull_change(int end, double dt, double dh) const { return dt * pull_by_t_[end] + dh * pull_by_h_[end]; }
  // Along the changes of the configurations at both ends of the step and of their times [s].
  void set_start_rows(const VecX& dq0, double dt);
  void set_end_rows(const VecX& dq1, double dt);
  void row_changes(const VecX& dq0, const VecX& dq1, const VecX& dv, const ContactStepDirection& d, VecX& dy);
  VecX constraint_changes(const VecX& dq0, const VecX& dq1, const VecX& dv, const ContactStepDirection& d) const;
  void end_change(const Problem& problem, const VecX& v, const ContactStepDirection& d, const VecX& dy, const VecX& dq1,
                  const VecX& dp_minus, const VecX& size, VecX& dlambda, VecX& dw);
  int joint_row(std::size_t k) const { return constraints_ + static_cast<int>(k); }
  Vec3 relative(const BodyTwists& twists, int contact, const Vec3& x) const;
  Vec3 place(const BodyTwists& twists, int contact) const;
  MatX turn(const Problem& problem, std::size_t friction) const;
  MatX friction_by_slip(const Problem& problem, const VecX& slip, const Friction& friction) const;

  const Scene* scene_;
  Kinks* kinks_;
  Integrator masses_;
  StepTangent step_;
  const ContactStepRecord* record_ = nullptr;
  BodyTwists twists0_, twists1_;
  std::vector<ContactTangent> start_, end_;
  // Of the surfaces of each contact at both ends.
  std::vector<SurfaceVelocityTangent> start_surfaces_, end_surfaces_;
  std::vector<Friction> frictions_;
  VecX own_end_;                                // velocities that surfaces have of themselves in the rows at the end
  VecX pull_[2], pull_by_t_[2], pull_by_h_[2];  // impulses of adhesion at both ends, by the time and by the length
  ConstraintTangent start_constraints_, end_constraints_;
  double margin_ = 1.0, slip_change_ = 0.0;
  bool slip_ends_ = false;
  int rows_ = 0, constraints_ = 0;  // constraints_: how many of the rows are those of constraints
  // Per unit of each position impulse: q1, p-, the stage's velocity, the rows.
  MatX Q_, P_, V_, Y_;
  MatX MinvW_, G_;
  VecX w_minus_;
  Problem position_, velocity_, frozen_;  // frozen_: the velocity impulse if the friction of the slips had gone on
  VecX v_frozen_;                         // the velocity after that
  // Along the present direction.
  MatX dW0_, dW1_;
  std::vector<Vec3> dn0_, dt1_;
  StepDirection step_direction_;  // of the smooth step, without the changes of the position impulses
  // Changes of the rates of the constraints at both ends, along it, and of the velocities of surfaces in the rows.
  VecX drate0_, drate1_, down0_, down1_;
  VecX dv_, dp_start_, dp_minus_, dy_, base_, dlambda_, dlambda_end_, dw_, work_, none_;
};

}  // namespace contactvi

// The derivative of one dense step (contact/dense_step.hpp), as it was solved, with the active sets of its problems.
//
// What is differentiated are these equations, in this order. D is the matrix of the step's iterations, at the start
// with the velocity v0; gaps and rows of a place are those at the end of that motion.
//   v_0      the smooth step from (q0, p0), q_0 = q0 (+) h v_0: the first place
//   round    D (v_a - v_r) = W0^T (L_a - L_r), the whole law for L_a with the speeds
//              w_n = (gap(q_p) - allowed)/h + W0_n (v_a - v_p),
//              w_t = W0_t v_a + (W_s - W0)_t v_s / 2 + (u_s + u_0) / 2
//            about a place p, from a place r (of no impulses, or p); then the smooth step from (q0, p0 + W0^T L) with
//            L_t = L_a,t and the L_n that close loaded gaps: the next place
//   end      v' = M1^-1 (p1- + W1^T L'), the whole law for L' and w = W1 v'
//   restitution: the same for L'' >= e (L + L'), of which a share is taken that just keeps the energy
// Where points adhere, L less the impulses of that acts, here and at the end; the laws are those of L.
// u are the velocities that surfaces have of themselves, at the end of a place and at the start, where coefficients of
// friction and of restitution that depend on the slip and the closing speed are those of the velocity v0.
// Constraints phi(q, t) = 0 are rows Phi without a cone in all of these: the smooth steps, the first one too, end on
// them, phi(q_p, t1) = 0, the law keeps Phi0 (v_a - v_r) = 0, and at the end Phi1 v + d phi/dt = 0.
// Where several points share a load, the impulses are those of least norm.
#pragma once

#include <Eigen/Cholesky>
#include <cmath>
#include <deque>

#include "contact/dense_step_record.hpp"
#include "geometry/guard.hpp"
#include "geometry/surface_velocity_tangent.hpp"
#include "model/constraint_tangent.hpp"
#include "sensitivity/dense_laws.hpp"
#include "sensitivity/kinks.hpp"
#include "sensitivity/recorded_run.hpp"
#include "sensitivity/step_masses.hpp"
#include "step/integrator.hpp"
#include "step/step_tangent.hpp"

namespace contactvi {

// A direction in all that a dense step depends on; what is empty does not change.
struct DenseStepDirection {
  VecX q, p;                // of the start, (nv,)
  double t = 0.0, h = 0.0;  // time of the start, of which constraints may be functions, and length
  VecX tau;                 // public coordinates, (nv,)
  VecX mu, e;               // of the contacts
  const StepParameters* parameters = nullptr;
  double size_q = 0.0, size_p = 0.0;  // largest change of q and p on the way: rounding is relative to it
};

class DenseStepTangent {
 public:
  // Where the laws do not determine how points share a load, and that decides about the motion, the derivative with
  // impulses of least norm is that of a kink that was taken.
  DenseStepTangent(const Scene& scene, Kinks& kinks);

  // Takes a step with its inputs; it is to stay alive. Throws NoDerivative.
  void take(const DenseStepRecord& step, const VecX& tau, const Servo* servo);
  // The derivative of (q1, p1), (nv,) each.
  void solve(const DenseStepDirection& direction, VecRef dq1, VecRef dp1);
  // Distance from the nearest change of an active set, relative to the impulses or the speeds.
  double margin() const { return margin_; }
  // Of the impulses and speeds: what does not satisfy the laws that are differentiated.
  double error() const { return error_; }
  // Why the derivative is not that of the step to rounding; empty: it is.
  const char* approximate() const { return approximate_; }

 private:
  friend class DenseStepAdjoint;  // its transpose, from the same parts
  struct Change {
    VecX q, v, lambda;
  };
  // How the law of a point that is found anew at the start of each step changes, in the frames of its bodies.
  struct LawChange {
    Vec3 center, normal;
    double offset;
  };
  // What it adds along a direction to the gap, the normal and the rows at some place.
  struct Extra {
    double gap = 0.0;
    Vec3 normal = Vec3::Zero();
    Eigen::Vector2d own = Eigen::Vector2d::Zero();  // the velocity of the surfaces
  };
  // The geometry of a contact at some place, and the velocity of its surfaces there.
  struct Site {
    ContactTangent contact;
    SurfaceVelocityTangent surface;
    explicit Site(const Scene& scene) : contact(scene) {}
  };
  // The coefficients of a contact: whether they are the numbers of its pair, and their derivatives by the speeds of its
  // tangential rows and of its normal one at the start.
  struct Coefficients {
    bool own_mu = true, own_e = true;
    Eigen::Vector2d mu_by_slip = Eigen::Vector2d::Zero();
    double e_by_closing = 0.0, e_by_time = 0.0;
    Eigen::Vector2d e_by_slip = Eigen::Vector2d::Zero();
    double without_rest =
        INFINITY;  // friction of a contact at rest if that were not larger than that of one that slides
  };
  // The step without other impulses than those of the constraints: its changes per unit of each of these, and the
  // equations for them.
  struct Free {
    MatX Q, V;
    SharedLoad system;
  };
  struct Round {
    explicit Round(const Tree& tree) : step(tree, 1) {}
    DenseLaws law, gaps;
    StepTangent step;  // with the impulses at its end
    MatX Q, P, V;      // changes per unit of each impulse: of the end, of the momentum there, of the velocity
    VecX lambda;       // at its end
    MatX mass_effect;  // StepMasses::effect of its change of velocity
  };
  struct End {  // the velocity impulse, or that with restitution
    DenseLaws laws;
    VecX lambda, v;
  };

  [[noreturn]] void refuse(const char* reason, int guard, const std::string& fact, const char* expected,
                           const std::string& got, const char* remedy) const;
  void set_scale();
  void note(const DenseLaws& laws);
  void approximate(const char* why) { approximate_ = *approximate_ == 0 ? why : approximate_; }
  void take_geometry();
  void take_sites(std::vector<Site>& sites, const VecX& q, double t, const std::vector<Contact>& at,
                  const std::vector<Vec3>& t1, VecX& own, VecX& rate);
  void take_coefficients();
  void coefficient_changes(const DenseStepDirection& d);
  void check_rest(const DenseStepDirection& d, std::size_t contact, const Eigen::Vector2d& slip_change);
  void take_masses(const VecX& tau, const Servo* servo);
  void take_free(const VecX& tau, const Servo* servo);
  void take_round(std::size_t k, const VecX& tau, const Servo* servo);
  void unit_changes(StepTangent& step, int rows, MatX& Q, MatX& P, MatX& V);
  void take_end();
  void take_energy();
  void check_shared(const DenseLaws& laws, const MatX& effect);
  void refuse_shared(const char* fact, const char* got, const char* remedy);
  void check_round(const Round& round);
  void check_expansion();
  void set_start_rows(const VecX& dq0, double dt);
  void add_found_rows(int place, const VecX& dq);
  void set_law_change(std::size_t contact, const Contact& at, const VecX& dq);
  Extra extra(std::size_t contact, const Site& site, const Contact& at, const Vec3& t1, Eigen::Ref<MatX> dW);
  Extra extra_gap(std::size_t contact, const Contact& at) const;
  VecX extra_gaps(const DenseStepRecord::Place& place);
  void clear_law_changes() { law_change_.assign(record_->contacts.size(), {Vec3::Zero(), Vec3::Zero(), 0.0}); }
  void set_end_rows(const VecX& dq1, double dt);
  void slip_change(int place, const VecX& dq, const VecX& dv, double dt_end, VecX& dslip);
  void matrix_change(const Round& round, const DenseStepDirection& d, const VecX& dq0, const VecX& u, VecX& change);
  double allowed_change(const DenseStepRecord::Contact& c, const VecX& dq0, double dh) const;
  VecX end_times(std::size_t place, const DenseStepDirection& d) const;
  void take_pulls();
  VecX pull_change(bool at_end, const DenseStepDirection& d) const;
  void solve_free(const DenseStepDirection& d, const VecX& dq0);
  void solve_round(std::size_t k, const DenseStepDirection& d, const VecX& dq0);
  void check_held_gaps(const Round& round, const DenseStepDirection& d, const VecX& dlaw, const VecX& dlambda);
  void low_changes(const Round& round, const VecX& mu, VecX& known) const;
  void solve_laws(const DenseLaws& laws, const VecX& base, const VecX& known, const VecX& mu, const VecX& size,
                  VecX& dlambda) const;
  VecX sizes(const DenseStepDirection& d) const;
  VecX end_base(const End& end, const DenseStepDirection& d, const VecX& dq1, const VecX& dp, VecX& force);
  VecX end_slip(int place, std::size_t contact) const;

  const Scene* scene_;
  Kinks* kinks_;
  Integrator start_masses_, masses_;
  StepMasses step_masses_;
  StepTangent free_;  // the step without other impulses than those of the constraints
  Free free_constraints_;
  ConstraintTangent start_constraints_, end_constraints_;
  std::vector<VecX> end_rates_;  // of the constraints, per place
  std::deque<Round> rounds_;
  const DenseStepRecord* record_ = nullptr;
  BodyTwists twists_;
  Guards guards_;
  std::vector<Site> start_, end_;
  std::vector<ContactTangent> found_;    // of points as they were found at the start
  std::vector<char> is_found_;           // whether the law of a point is not the point as it was found
  std::vector<std::vector<Site>> slip_;  // per place with which slips are made
  // Velocities that surfaces have of themselves in the rows at the start, at the end and at those places, and their
  // derivatives by the time.
  VecX own0_, own1_, own0_rate_, own1_rate_;
  VecX pull0_, pull1_, pull0_rate_, pull1_rate_;  // impulses of adhesion in the rows at both ends, by their times
  std::vector<VecX> slip_own_, slip_own_rate_;
  std::vector<Coefficients> coefficients_;
  double margin_ = 1.0, error_ = 0.0;
  const char* approximate_ = "";
  int rows_ = 0, constraints_ = 0;  // constraints_: how many of the rows are those of constraints
  DenseLaws::Scale scale_{};
  bool has_friction_ = false;
  VecX v0_, q_stage_;  // at the start; of the stage where D is made
  Eigen::LLT<MatX> D_;
  MatX DinvW_, MinvW_, G_;
  End plastic_, expansion_;
  VecX slope_, energy_q0_, energy_q1_, energy_v0_;  // of the energies at both ends, where an expansion is cut
  double expansion_rate_ = 0.0;                     // energy per share [J]
  // Along the present direction.
  MatX dW0_, dW1_;
  VecX down0_, down1_;  // of the velocities of surfaces at both ends
  VecX dmu_, de_;       // of the coefficients of the contacts
  std::vector<Vec3> dn0_, dt1_;
  std::vector<LawChange> law_change_;
  std::vector<Change> places_;
  VecX none_, dv0_, dp_, work_;
};

}  // namespace contactvi

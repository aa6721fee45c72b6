// The derivative of one impact: of p+ with respect to q at the impact, p-, the restitution and the friction; for the
// implicit maps also with respect to their reference and to the length of the rest of the step.
//
// With the rows W of the contact, Z = M^-1 W, u = M^-1 p-, gamma = W^T u and the Delassus matrix G = W^T Z,
//   dgamma = dW^T u + Z^T (dp- - d(M u)|u),   dG = dW^T Z + Z^T dW - Z^T d(M Z)|Z,   dp+ = dp- + dW Lambda + W dLambda,
// d(M x)|x the change of M x with q at a constant x. dW comes from the curvature of the gap (ContactTangent). dLambda
// follows from the law of the impact: CTEC's is explicit, the implicit maps' is one scalar equation, and Poisson's two
// cone problems, of friction and of several points, have PoissonTangent. With constraints the rows are those projected
// on them, whose changes are ProjectionTangent's.
#pragma once

#include <memory>

#include "contact/contact_step.hpp"
#include "geometry/contact_tangent.hpp"
#include "geometry/surface_velocity_tangent.hpp"
#include "impact/sequence.hpp"
#include "model/restitution.hpp"
#include "sensitivity/contact_step_tangent.hpp"
#include "sensitivity/piece_inputs.hpp"
#include "sensitivity/poisson_tangent.hpp"
#include "sensitivity/projection_tangent.hpp"
#include "step/step_adjoint.hpp"
#include "step/step_tangent.hpp"

namespace contactvi {

// A direction in all that an impact depends on.
struct ImpactDirection {
  VecX q, p;             // at the impact, before it: (nv,)
  VecX e, mu;            // restitution and friction of the points of the impact
  double size_p = 0;     // largest change of p on the way: rounding is relative to it
  double reference = 0;  // of the implicit maps: their scalar before the impact [J]
  double rest = 0;       // length of the rest of the step [s]
  double time = 0;       // of the impact [s]
  const StepParameters* parameters = nullptr;
  bool checked = true;  // whether points that share an impulse may not contradict each other along it
};

class ImpactTangent {
 public:
  ImpactTangent(const Scene& scene, const RecordedRun& run, Kinks& kinks);

  // Takes an impact, p_plus after all of its records; tau, servo: of the control step. Throws NoDerivative.
  void take(const RecordedImpact& impact, const VecX& p_plus, const VecX& tau, const Servo* servo);
  int points() const { return static_cast<int>(points_.size()); }
  int guard(int point) const { return contact_of(point).guard; }
  // Whether an impulse of a point depends on the coefficient of restitution of its pair.
  bool takes_restitution(int point) const {
    const ContactLaw* law = scene_->law(guard(point));
    return points_[point].e > 0.0 && (law == nullptr || !restitution_varies(*law));
  }
  // Which of its points this is; -1: none.
  int find(const ContactPoint& point) const;
  // W of the normal row of a point, (nv,): the gradient of its gap.
  VecX gradient(int point) const { return gradients_.col(points_[point].row); }
  const ContactTangent& contact(int point) const { return contacts_[point]; }
  // dp+ (nv,), and the derivative of the energy that the impact takes, with implicit maps also by prescribed motions
  // [J].
  void apply(const ImpactDirection& direction, VecRef dp, double& loss);
  // Adds the gradients in the inertias of the impact, but not of an implicit map's, from the gradient in p+.
  void add_parameters(const VecX& lp, StepAdjoint& adjoint, StepParameters& sums);
  // |gamma-| over the sum of the sizes of its terms: how far an impact of one point is from grazing, 0 to 1; 1 of
  // several points.
  double approach() const { return approach_; }
  // Distance from the next change of the active set of friction, relative to the impulse; 1 without friction.
  double margin() const { return margin_; }

 private:
  const ContactPoint& contact_of(int point) const { return contact_points_[point]; }
  [[noreturn]] void refuse(const char* reason, int guard, const char* fact, const char* expected,
                           const std::string& got, const char* remedy) const;
  // An obstacle that is a kink.
  void meet(const char* reason, int guard, const char* fact, const char* expected, const std::string& got,
            const char* remedy) const;
  void collect(const RecordedImpact& impact);
  void take_rows(const RecordedImpact& impact);
  void take_poisson(const RecordedImpact& impact);
  void take_rest(const RecordedImpact& impact, const VecX& tau, const Servo* servo);
  void take_constrained_rest(const RecordedImpact& impact, const VecX& tau, const Servo* servo);
  void add_row_changes(const ImpactDirection& direction);
  VecX restitution_changes(const ImpactDirection& direction) const;
  VecX friction_changes(const ImpactDirection& direction) const;
  void apply_law(const ImpactDirection& direction, VecX& dlambda);
  void apply_other_law(const ImpactDirection& direction, const VecX& de, VecX& dlambda);
  double rest_change(const VecX& dq, const VecX& dp, double dh, double dt);

  const Scene* scene_;
  const RecordedRun* run_;
  Kinks* kinks_;
  Integrator integrator_;
  Guards guards_;
  ImpactSequence sequence_;
  ImpactBlock impact_block_;
  PoissonTangent law_;
  const ContactLaw* other_law_ = nullptr;  // of the impact, if it is not Poisson's in two phases
  std::vector<char> course_;               // of the impact by that law
  ProjectionTangent projection_;
  std::vector<ContactTangent> contacts_;
  StepTangent rest_;
  const RecordedImpact* impact_ = nullptr;
  double approach_ = 0, margin_ = 1;
  bool implicit_ = false;
  std::vector<ImpactPoint> points_;
  std::vector<ContactPoint> contact_points_;
  std::vector<Vec3> t1_;
  std::vector<SurfaceVelocityTangent> surfaces_;  // of the points
  int rows_ = 1;
  VecX u_, lambda_, gamma_;
  MatX gradients_, W_, Z_, G_, dW_, dG_;  // gradients_: the rows before constraints answer
  MatX mu_fixed_, turned_;                // impulses of constraints per unit of a row's; d(M Z)|Z
  VecX offset_, doffset_, dgamma_, work_;
  // Of the rest of the step: its end, and dH/dq there; the derivative of the map's scalar along W.
  VecX q1_, p1_, v1_, force1_, dq1_, dp1_;
  double scalar_slope_ = 0;
  // The rest of the step that constraints act in; null: of a scene without.
  struct ConstrainedRest {
    ContactStep step;
    ContactStepRecord record;
    ContactStepTangent tangent;
  };
  std::unique_ptr<ConstrainedRest> constrained_rest_;
};

}  // namespace contactvi

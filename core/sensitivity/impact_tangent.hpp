// The derivative of one impact: of p+ with respect to q at the impact, p-, the restitution and the friction; for the
// implicit maps also with respect to their reference and to the length of the rest of the step.
//
// With the rows W of the contact, Z = M^-1 W, u = M^-1 p-, gamma = W^T u and the Delassus matrix G = W^T Z,
//   dgamma = dW^T u + Z^T (dp- - d(M u)|u),   dG = dW^T Z + Z^T dW - Z^T d(M Z)|Z,   dp+ = dp- + dW Lambda + W dLambda,
// d(M x)|x the change of M x with q at a constant x. dW comes from the curvature of the gap (ContactTangent). dLambda
// follows from the law of the impact: CTEC's is explicit, the implicit maps' is one scalar equation, and Poisson's two
// cone problems are differentiated with the active set of their solution.
#pragma once

#include "geometry/contact_tangent.hpp"
#include "impact/sequence.hpp"
#include "sensitivity/piece_inputs.hpp"
#include "step/step_adjoint.hpp"
#include "step/step_tangent.hpp"

namespace contactvi {

// A direction in all that an impact depends on.
struct ImpactDirection {
  VecX q, p;             // at the impact, before it: (nv,)
  double e = 0, mu = 0;  // restitution and friction
  double reference = 0;  // of the implicit maps: their scalar before the impact [J]
  double rest = 0;       // length of the rest of the step [s]
  const StepParameters* parameters = nullptr;
};

class ImpactTangent {
 public:
  ImpactTangent(const Scene& scene, const RecordedRun& run);

  // Takes an impact; tau, servo: of the control step. Throws NoDerivative.
  void take(const RecordedImpact& impact, const VecX& tau, const Servo* servo);
  // W of the normal row of the contact that was taken, (nv,).
  const VecX& gradient() const { return W_normal_; }
  // dp+ (nv,), and the derivative of the energy that the impact takes [J].
  void apply(const ImpactDirection& direction, VecRef dp, double& loss);
  // Adds the gradients in the inertias of the impact, but not of an implicit map's, from the gradient in p+.
  void add_parameters(const VecX& lp, StepAdjoint& adjoint, StepParameters& sums);
  // |gamma-| over the sum of the sizes of its terms: how far the impact is from grazing, 0 to 1.
  double approach() const { return approach_; }
  // Distance from the next change of the active set of friction, relative to the impulse; 1 without friction.
  double margin() const { return margin_; }

 private:
  enum class Mode { kOpen, kSlip, kStick };

  void take_rows(const RecordedImpact& impact);
  void take_friction(const RecordedImpact& impact);
  void take_rest(const RecordedImpact& impact, const VecX& tau, const Servo* servo);
  Mode mode_of(const VecX& lambda, const VecX& gamma, double lower, double mu);
  void add_row_changes(const ImpactDirection& direction);
  void apply_law(const ImpactDirection& direction, VecRef dlambda) const;
  void apply_friction(const ImpactDirection& direction, VecRef dlambda) const;
  VecX phase(Mode mode, const VecX& lambda, const VecX& gamma, const VecX& dgamma0, double dlower, double lower,
             double mu, double dmu) const;
  double rest_change(const VecX& dq, const VecX& dp, double dh);

  const Scene* scene_;
  const RecordedRun* run_;
  Integrator integrator_;
  Guards guards_;
  ImpactSequence sequence_;
  PoissonImpact poisson_;
  ContactTangent contact_;
  StepTangent rest_;
  const RecordedImpact* impact_ = nullptr;
  double approach_ = 0, margin_ = 1;
  bool implicit_ = false;
  int rows_ = 1;
  Vec3 t1_;
  VecX u_, W_normal_, lambda_, gamma_, first_, second_;
  MatX W_, Z_, G_, dW_, dG_;
  VecX dgamma_, work_;
  Mode compression_ = Mode::kOpen, expansion_ = Mode::kOpen;
  // Of the rest of the step: its end, and dH/dq there; the derivative of the map's scalar along W.
  VecX q1_, p1_, v1_, force1_, dq1_, dp1_;
  double scalar_slope_ = 0;
};

}  // namespace contactvi

// Second derivatives of the impact of one point without friction by the explicit map (CTEC), where the third derivative
// of the gap is closed (GapCurvature).
//
// With W the gradient of the gap, u = M^-1 p, z = M^-1 W, gamma = W . u, G = W . z and lambda = -(1 + e) gamma / G the
// map is p+ = p + lambda W. From the gradient l in p+ come those in p and q,
//   l + c z,   grad_q (y . W) - grad_q (z . M x),
//   c = -(1 + e) (l . W) / G,   d = -lambda (l . W) / G,   y = lambda l + c u + 2 d z,   x = c u + d z,
// y, z and x being constant under grad_q. All of it is computed with dual numbers along a direction.
#pragma once

#include "geometry/gap_curvature.hpp"
#include "sensitivity/impact_tangent.hpp"
#include "step/public_hessian.hpp"

namespace contactvi {

class ImpactHessian {
 public:
  ImpactHessian(const Scene& scene, const RecordedRun& run);

  // Takes an impact that `first` has taken, and what changes before it along a direction, (nv,). Throws NoDerivative.
  void take(const RecordedImpact& impact, const ImpactTangent& first, const VecX& dq, const VecX& dp);
  // The gradient of the gap at the impact, with its change.
  const DualX& gradient() const { return W_; }
  // The gradient in (q, p+) and its change become those in (q, p).
  void apply(MovingGradient& l);

 private:
  const RecordedImpact* impact_ = nullptr;
  Integrator integrator_;
  GapCurvature gap_;
  PublicHessian mass_;
  VecX dq_;
  DualX W_, u_, z_, of_q_;
  DualNumber gamma_, G_;
};

}  // namespace contactvi

// How rows change that are projected on the constraints (step/projection.hpp).
//
// With the gradients Phi of the constraints, Z_Phi = M^-1 Phi, K = Phi^T Z_Phi, and the projected rows
// W' = W - Phi mu, Z' = M^-1 W', Phi^T Z' = 0:
//   dW' = dW - dPhi mu - Phi dmu,   K dmu = dPhi^T Z' + Z_Phi^T (dW - dPhi mu - dM Z')
// and the part of the rows' speeds that moving constraints cause changes by d(-mu . rate).
#pragma once

#include "model/constraint_tangent.hpp"
#include "sensitivity/shared_load.hpp"
#include "step/integrator.hpp"

namespace contactvi {

class ProjectionTangent {
 public:
  explicit ProjectionTangent(const Tree& tree);
  bool any() const { return constraints_.rows() > 0; }
  // The constraints at q and t [s], where the node of `equations` is placed.
  void take(StepEquations& equations, const VecX& q, double t);
  // Rows W' and Z' (nv, k) with their mu (rows, k), which stay alive. Those that the constraints leave no motion become
  // zero. Returns the rows W as they were before the projection.
  MatX take_rows(const MatX& mu, MatX& W, MatX& Z);
  // From the change of W to that of W', in place; turned: dM Z'. offset: the change of the rows' speeds that moving
  // constraints cause. dq as in ConstraintTangent, dt of the time.
  void change(const VecX& dq, double dt, const MatX& turned, MatX& dW, VecX& offset);
  // From the gradients in W' (nv, k) and in the speeds of the rows (k,): the vectors that dM Z' of each row meets.
  MatX mass_gradient(const MatX& lW, const VecX& lspeeds) const;

 private:
  ConstraintTangent constraints_;
  SharedLoad system_;
  MatX MinvPhi_, dPhi_;
  const MatX *mu_ = nullptr, *Z_ = nullptr;
  std::vector<char> immobile_;
};

}  // namespace contactvi

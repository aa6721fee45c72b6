#include "step/public_tangent.hpp"

#include "model/coordinates.hpp"
#include "model/coupling.hpp"

namespace contactvi {

void to_engine_direction(const Tree& tree, StepTangent& tangent, const StateView& at, VecX& dq, VecX& dx) {
  // What a follower's own numbers change by counts for nothing.
  follow_velocity(tree, dq);
  if (at.kind == StateKind::kVelocity) follow_velocity(tree, dx);
  public_to_engine(tree, at.q, dq);
  public_to_engine_tangent(tree, at.q, dq, at.x, dx);
  if (at.kind == StateKind::kMomentum) return;
  VecX dp(tree.nv);
  tangent.momentum(at.q, at.v, dq, dx, dp);
  dx = dp;
}

void to_public_direction(const Tree& tree, StepTangent& tangent, StepEquations& equations, const StateView& at,
                         VecX& dq, VecX& dp) {
  const bool velocity = at.kind == StateKind::kVelocity;
  if (velocity || !tree.followers.empty()) {
    VecX moved(tree.nv);
    tangent.momentum(at.q, at.v, dq, VecX::Zero(tree.nv), moved);
    dp -= moved;
    equations.place_node(at.q);
    equations.solve_mass(dp);
  }
  if (!velocity && !tree.followers.empty()) {  // of coupled joints the public momentum is M v
    const VecX dv = dp;
    tangent.momentum(at.q, at.v, dq, dv, dp);
  }
  engine_to_public_tangent(tree, at.q, dq, velocity ? at.v : at.p, dp);
  engine_to_public(tree, at.q, dq);
}

void to_engine_gradient(const Tree& tree, StepAdjoint& adjoint, StepEquations& equations, const StateView& at, VecX& lq,
                        VecX& lx, StepParameters& sums) {
  const bool velocity = at.kind == StateKind::kVelocity;
  public_to_engine(tree, at.q, lq);
  engine_to_public_adjoint(tree, at.q, velocity ? at.v : at.p, lx, lq);
  if (!velocity && tree.followers.empty()) return;
  VecX of_q(tree.nv), of_v(tree.nv);
  if (!velocity) {  // of coupled joints the public momentum is M v
    adjoint.add_momentum_parameters(at.q, at.v, lx, sums);
    adjoint.momentum(at.q, at.v, lx, of_q, of_v);
    lq += of_q;
    lx = of_v;
  }
  // v = M^-1 p
  equations.place_node(at.q);
  equations.solve_mass(lx);
  adjoint.momentum(at.q, at.v, lx, of_q, of_v);
  lq -= of_q;
  adjoint.add_momentum_parameters(at.q, at.v, -lx, sums);
}

void to_public_gradient(const Tree& tree, StepAdjoint& adjoint, const StateView& at, VecX& lq, VecX& lp,
                        StepParameters& sums) {
  if (at.kind == StateKind::kVelocity) {
    VecX of_q(tree.nv), of_v(tree.nv);
    adjoint.add_momentum_parameters(at.q, at.v, lp, sums);
    adjoint.momentum(at.q, at.v, lp, of_q, of_v);
    lq += of_q;
    lp = of_v;
  }
  public_to_engine_adjoint(tree, at.q, at.x, lp, lq);
  engine_to_public(tree, at.q, lq);
  // The transpose of what to_engine_direction does first.
  fold_momentum(tree, lq);
  if (at.kind == StateKind::kVelocity) fold_momentum(tree, lp);
}

}  // namespace contactvi

#include "step/public_tangent.hpp"

#include "model/coordinates.hpp"

namespace contactvi {

void to_engine_direction(const Tree& tree, StepTangent& tangent, const StateView& at, VecX& dq, VecX& dx) {
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
  if (velocity) {
    VecX moved(tree.nv);
    tangent.momentum(at.q, at.v, dq, VecX::Zero(tree.nv), moved);
    dp -= moved;
    equations.place_node(at.q);
    equations.solve_mass(dp);
  }
  engine_to_public_tangent(tree, at.q, dq, velocity ? at.v : at.p, dp);
  engine_to_public(tree, at.q, dq);
}

void to_engine_gradient(const Tree& tree, StepAdjoint& adjoint, StepEquations& equations, const StateView& at, VecX& lq,
                        VecX& lx, StepParameters& sums) {
  const bool velocity = at.kind == StateKind::kVelocity;
  public_to_engine(tree, at.q, lq);
  engine_to_public_adjoint(tree, at.q, velocity ? at.v : at.p, lx, lq);
  if (!velocity) return;
  // v = M^-1 p
  VecX of_q(tree.nv), of_v(tree.nv);
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
}

}  // namespace contactvi

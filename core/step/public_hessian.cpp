#include "step/public_hessian.hpp"

#include "model/coordinates.hpp"

namespace contactvi {

PublicHessian::PublicHessian(const Tree& tree, int stages)
    : tree_(&tree), model_(tree), node_(tree, model_, 1, 2), tangent_(tree, stages) {}

void PublicHessian::take(const VecX& q, const VecX& v, const VecX& dq, const VecX& dp, StepEquations& equations) {
  q_ = q;
  v_ = v;
  dq_ = dq;
  dv_ = dp - momentum_change(v);
  equations.place_node(q);
  equations.solve_mass(dv_);
}

VecX PublicHessian::momentum_change(const VecX& x) {
  VecX moved(tree_->nv);
  tangent_.momentum(q_, x, dq_, VecX::Zero(tree_->nv), moved);
  return moved;
}

MovingGradient PublicHessian::momentum(const VecX& x, const VecX& dx, const VecX& l, const VecX& dl) {
  node_.at(q_);
  const int S = node_.padded();
  const long shadow = node_.work_.shadow;
  node_.set_base_change(dq_, 2 * shadow);
  for (int d = 0; d < tree_->nv; ++d)
    for (int i = 0; i < S; ++i) {
      double* at = node_.v_ + d * S + i;
      at[0] = x[d];
      at[shadow] = l[d];
      at[2 * shadow] = dx[d];
      at[3 * shadow] = dl[d];
    }
  node_.kernel().evaluate_second(&model_.lanes, &node_.work_);
  const VecX none = VecX::Zero(tree_->nv);
  MovingGradient of{none, none, none, none};
  for (int d = 0; d < tree_->nv; ++d) {
    const double *P = node_.P_ + d * S, *G = node_.G_ + d * S;
    of.v[d] = P[shadow];
    of.q[d] = G[shadow];
    of.dv[d] = P[3 * shadow];
    of.dq[d] = G[3 * shadow];
  }
  return of;
}

// What the gradient in a turn has of a linear part x that turns with the body: sign x cross its gradient; x, l public.
void PublicHessian::add_turns(double sign, const VecX& x, const VecX& dx, MovingGradient& l) const {
  for (const SplitJoint& split : tree_->split) {
    const int iv = split.iv;
    if (split.planar) {
      const auto turn = [&](const VecX& a, const VecX& b) { return sign * (a[iv] * b[iv + 1] - a[iv + 1] * b[iv]); };
      l.q[iv + 2] += turn(x, l.v);
      l.dq[iv + 2] += turn(dx, l.v) + turn(x, l.dv);
      continue;
    }
    const auto turn = [&](const VecX& a, const VecX& b) {
      return Vec3(sign * Vec3(a.segment<3>(iv)).cross(Vec3(b.segment<3>(iv))));
    };
    l.q.segment<3>(iv + 3) += turn(x, l.v);
    l.dq.segment<3>(iv + 3) += turn(dx, l.v) + turn(x, l.dv);
  }
}

void PublicHessian::to_engine(MovingGradient& l, StepEquations& equations) {
  VecX x = v_, dx = dv_;  // the public velocity
  engine_to_public_tangent(*tree_, q_, dq_, v_, dx);
  engine_to_public(*tree_, q_, x);
  public_to_engine_tangent(*tree_, q_, dq_, l.q, l.dq);
  public_to_engine(*tree_, q_, l.q);
  add_turns(-1.0, x, dx, l);
  public_to_engine_tangent(*tree_, q_, dq_, l.v, l.dv);
  public_to_engine(*tree_, q_, l.v);
  // v = M^-1 p: M dz = dl - dM z for z = M^-1 l
  equations.place_node(q_);
  equations.solve_mass(l.v);
  l.dv -= momentum_change(l.v);
  equations.solve_mass(l.dv);
  const MovingGradient of = momentum(v_, dv_, l.v, l.dv);
  l.q -= of.q;
  l.dq -= of.dq;
}

void PublicHessian::to_public(MovingGradient& l) {
  VecX x = v_, dx = dv_;
  engine_to_public_tangent(*tree_, q_, dq_, v_, dx);
  engine_to_public(*tree_, q_, x);
  const MovingGradient of = momentum(v_, dv_, l.v, l.dv);
  l.q += of.q;
  l.dq += of.dq;
  l.v = of.v;
  l.dv = of.dv;
  engine_to_public_tangent(*tree_, q_, dq_, l.v, l.dv);
  engine_to_public(*tree_, q_, l.v);
  // The gradient in a turn is of the engine's directions: it moves with the body as the linear part does.
  engine_to_public_tangent(*tree_, q_, dq_, l.q, l.dq);
  engine_to_public(*tree_, q_, l.q);
  add_turns(1.0, x, dx, l);
}

void PublicHessian::add_bracket(const Tree& tree, const VecCRef& w, const VecCRef& l, double factor, VecRef out) {
  for (const Joint& joint : tree.joints)
    if (joint.type == JointType::kSpherical) {
      const Vec3 turn = w.segment<3>(joint.iv), own = l.segment<3>(joint.iv);
      out.segment<3>(joint.iv) += factor * own.cross(turn);
    }
  for (const SplitJoint& split : tree.split) {
    const int iv = split.iv;
    if (split.planar) {
      out[iv] += factor * l[iv + 1] * w[iv + 2];
      out[iv + 1] -= factor * l[iv] * w[iv + 2];
      out[iv + 2] += factor * (l[iv] * w[iv + 1] - l[iv + 1] * w[iv]);
      continue;
    }
    const Vec3 u = w.segment<3>(iv), turn = w.segment<3>(iv + 3), own = l.segment<3>(iv);
    out.segment<3>(iv) += factor * own.cross(turn);
    out.segment<3>(iv + 3) += factor * own.cross(u);
  }
}

}  // namespace contactvi

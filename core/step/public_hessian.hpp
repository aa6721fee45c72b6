// How gradients at a state change along a direction, between public coordinates (q, v) and the engine's (q, p): the
// derivatives of to_engine_gradient and to_public_gradient (public_tangent.hpp).
//
// A change of a gradient is that of its numbers, l(x exp(s w)) by s, for a direction w. The second derivative of a
// function J in exponential coordinates at x, of d -> J(x exp(d)), is symmetric and differs from it by half of a
// bracket: H w = dl - ad_w^T l / 2.
#pragma once

#include "step/step_equations.hpp"
#include "step/step_tangent.hpp"

namespace contactvi {

// A gradient (nv,) and its change.
struct MovingGradient {
  VecX q, v;    // in q, and in the velocity or the momentum
  VecX dq, dv;  // their changes
};

class PublicHessian {
 public:
  PublicHessian(const Tree& tree, int stages);

  // Takes a state with the engine's velocity, and the engine's direction (dq, dp) there.
  void take(const VecX& q, const VecX& v, const VecX& dq, const VecX& dp, StepEquations& equations);
  // Of the velocity, engine coordinates.
  const VecX& velocity_change() const { return dv_; }
  void to_engine(MovingGradient& l, StepEquations& equations);
  void to_public(MovingGradient& l);
  // out += factor ad_w^T l, in public coordinates.
  static void add_bracket(const Tree& tree, const VecCRef& w, const VecCRef& l, double factor, VecRef out);

  // Gradients in q and x of l . M(q) x, and their changes, for vectors with changes of their own.
  MovingGradient momentum(const VecX& x, const VecX& dx, const VecX& l, const VecX& dl);
  // The change of M(q) x at a constant x.
  VecX momentum_change(const VecX& x);

 private:
  void add_turns(double sign, const VecX& x, const VecX& dx, MovingGradient& l) const;

  const Tree* tree_;
  FlatModel model_;
  Stages node_;
  StepTangent tangent_;
  VecX q_, v_, dq_, dv_;
};

}  // namespace contactvi

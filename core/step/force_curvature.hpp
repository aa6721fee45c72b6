// Second derivatives of the forces in G besides gravity, at one stage of a step (ForceAdjoint has the first ones):
// springs of spherical joints, inputs on split joints, and the elements. Linear forces have none. Engine coordinates.
#pragma once

#include "model/element_curvature.hpp"

namespace contactvi {

// A state at a time [s] and a direction there: tangent vector and change of the velocity, (nv,).
struct MovingState {
  double time;
  VecX q, v, dq, dv;
};

class ForceCurvature {
 public:
  explicit ForceCurvature(const Tree& tree);

  bool any() const { return any_; }
  // Adds what the gradients of f_bar . F in q and v change by along the direction, for a constant f_bar; tau, dtau: the
  // inputs in public coordinates and their change, (nv,) or empty.
  void add(const MovingState& at, const VecX& tau, const VecX& dtau, const VecCRef& f_bar, VecRef lq, VecRef lv);
  // The same of the gradient in the inputs, public coordinates, (nv,).
  void add_inputs(const MovingState& at, const VecCRef& f_bar, VecRef ltau) const;

 private:
  void add_turn(const SplitJoint& split, const VecX& tau, const Vec3& force, VecRef lq) const;

  const Tree* tree_;
  ElementCurvature elements_;
  bool has_ball_springs_ = false, any_;
};

}  // namespace contactvi

// Second derivatives of a smooth step along a direction: what the gradients that StepAdjoint gives change by when the
// start, the length and the inputs of the step move, and with them the gradient in its end.
//
// The adjoint equations are A(y, x)^T mu + b(l; y, x) = 0, with the stages y, the start x and the gradient l in the
// end. Along a direction their derivative is
//   A^T dmu + b(dl) + [d(A^T) mu + db(l)] = 0,
// with the stages' change dy of StepTangent: the same equations for dmu, with what is in brackets as a source. The
// source is one sweep of StepAdjoint with numbers and their derivatives, at a constant mu and l, and needs the second
// derivatives of the momenta and forces: the kernel's nested duals.
//
// Engine coordinates. The gradients' changes are those of their numbers, dual to tangent vectors at the state that
// moves, which are body-fixed on spherical joints: along a turn w they are the derivative of l(q exp(s w)) by s.
#pragma once

#include <vector>

#include "step/force_curvature.hpp"
#include "step/step_adjoint.hpp"
#include "step/step_tangent.hpp"

namespace contactvi {

// Gradients in the start, the length and the inputs of a step, or their change.
struct PartialGradient {
  explicit PartialGradient(int nv) : q(VecX::Zero(nv)), p(q), tau(q) {}
  VecX q, p;       // (nv,)
  double h = 0.0;  // [1/s]
  VecX tau;        // public coordinates, (nv,)
};

class StepHessian {
 public:
  StepHessian(const Tree& tree, int stages);

  // Takes a solved step: its start, length and forces, and the velocities at its stages, (nv, s).
  void take(const VecX& q0, const VecX& p0, double h, const VecX& tau, double time, const Servo* servo,
            const MatX& velocities);
  // The step's tangent, which has to have the direction (solve or resume) before what follows.
  StepTangent& tangent() { return tangent_; }
  // From the gradient l in (q1, p1) and its change dl those in the step's start, length and inputs, along the
  // direction. False where the equations were not solved.
  bool solve(const StepDirection& direction, const VecCRef& lq, const VecCRef& lp, const VecCRef& dlq,
             const VecCRef& dlp, PartialGradient& gradient, PartialGradient& change);

 private:
  using Array = std::vector<DualNumber>;  // over dofs and stages, [dof * s + stage]
  // The stages, the multipliers, and what StepAdjoint makes of them.
  struct Numbers {
    Array X, v, P, G, mu, momenta, P_bar, G_bar, turn, v_bar, q_bar, X_bar, sums;
  };

  void take_stages(const StepDirection& direction);
  void set_kernel(const StepDirection& direction);
  void sweep(const StepDirection& direction, PartialGradient& change);
  void add_forces(const StepDirection& direction);
  void finish(PartialGradient& change);
  void combine(const Array& in, Array& out) const;
  DualNumber* row(Array& array, int dof) { return array.data() + static_cast<std::size_t>(dof) * s_; }

  const Tree* tree_;
  int s_;
  StepTangent tangent_;
  StepAdjoint adjoint_;
  Stages second_;  // of two directions: the multipliers', and that of the step
  ForceCurvature curvature_;
  std::vector<BallAdjointOf<DualNumber>> balls_;
  MovingState at_;
  DualNumber h_;
  VecX lq_, lp_;
  Numbers stage_;
  AlignedArray source_, part_G_, part_v_, part_q_;  // [dof * padded + stage]
};

}  // namespace contactvi

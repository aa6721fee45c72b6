// The transposed derivative of a smooth step that keeps rows: from the gradient of some function in its end to those in
// all that it depends on. The transpose of HeldStepTangent::solve(), by its matrix.
//
// Gradients in the parameters follow from the multipliers of the stage equations, as those of a step without rows.
#pragma once

#include "sensitivity/contact_step_adjoint.hpp"
#include "sensitivity/held_step_tangent.hpp"

namespace contactvi {

class HeldStepAdjoint {
 public:
  HeldStepAdjoint(const Scene& scene, int stages);

  // Takes a step with its inputs; it is to stay alive. Throws NoDerivative.
  void take(const HeldStepRecord& step, const VecX& tau, const Servo* servo);
  // The step that was taken, forward.
  HeldStepTangent& tangent() { return tangent_; }
  // From the gradients in (q1, p1), (nv,) each. Adds those in the parameters. False where the equations were not
  // solved.
  bool solve(const VecX& lq, const VecX& lp, ContactStepGradient& gradient, StepParameters& sums);

 private:
  // What a part of a direction changes the equations and the end by, before its impulse.
  struct Columns {
    MatX off, ends;
  };
  Columns columns(int count, VecX ContactStepDirection::* part);
  Columns columns(double ContactStepDirection::* part);
  void pass_end(const VecX& lq, const VecX& lp, StepParameters& sums);

  HeldStepTangent tangent_;
  StepAdjoint adjoint_;
  Columns by_q_, by_p_, by_tau_, by_t_, by_h_;
  // Gradients in q1 and in p before the impulse at the end; in the times.
  VecX lend_;
  double lt_ = 0.0, lh_ = 0.0;
};

}  // namespace contactvi

// The transposed derivative of a smooth step that keeps rows: from the gradient of some function in its end to those in
// all that it depends on. The transpose of HeldStepTangent::solve(), by its matrix.
//
// Gradients in the parameters follow from the multipliers of the stage equations, as those of a step without rows, and
// from the gradients in the momenta at both ends, whose velocities decide about the impulses.
#pragma once

#include "sensitivity/contact_step_adjoint.hpp"
#include "sensitivity/held_step_tangent.hpp"

namespace contactvi {

class HeldStepAdjoint {
 public:
  HeldStepAdjoint(const Scene& scene, int stages, int contact_points, Kinks& kinks);

  // Takes a step with its inputs; it is to stay alive. Throws NoDerivative.
  void take(const HeldStepRecord& step, const VecX& tau, const Servo* servo);
  // The step that was taken, forward.
  HeldStepTangent& tangent() { return tangent_; }
  // From the gradients in (q1, p1), (nv,) each, and in the slip whose end ended the step. Adds those in the parameters.
  // False where the equations were not solved.
  bool solve(const VecX& lq, const VecX& lp, double lslip, ContactStepGradient& gradient, StepParameters& sums);

 private:
  // What a part of a direction changes the equations and the end by.
  struct Columns {
    MatX off, ends;
  };
  // Those of `count` numbers of a direction, which entry(k) refers to.
  template <class Entry>
  Columns columns(int count, ContactStepDirection& direction, Entry entry);
  Columns turn_columns();
  HeldStepTangent tangent_;
  StepAdjoint adjoint_;
  Columns by_q_, by_p_, by_tau_, by_t_, by_h_, by_anchors_, by_mu_;
  Columns by_start_;  // by the directions of the slips at the start
};

}  // namespace contactvi

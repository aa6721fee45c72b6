// The transposed derivative of a step with persistent contacts: from the gradient of some function in its end to those
// in all that it depends on.
//
// It is the transpose of ContactStepTangent::solve(), part by part in the reverse order. That of the smooth step is
// StepAdjoint; the rows of the contacts, which are few, have their derivatives made as matrices, column by column.
#pragma once

#include "sensitivity/contact_step_tangent.hpp"
#include "step/step_adjoint.hpp"

namespace contactvi {

// Gradients in what a contact step depends on; those of ContactStepDirection.
struct ContactStepGradient {
  VecX q, p;
  double t = 0.0, h = 0.0;
  VecX tau, mu;
  MatX anchors;
  VecX joints;
};

class ContactStepAdjoint {
 public:
  ContactStepAdjoint(const Scene& scene, Kinks& kinks);

  // Takes a step with its inputs; it is to stay alive. Throws NoDerivative.
  void take(const ContactStepRecord& step, const VecX& tau, const Servo* servo);
  // The step that was taken, forward.
  ContactStepTangent& tangent() { return tangent_; }
  // From the gradients in (q1, p1), (nv,) each, and in the slip whose end ended the step. Adds those in the parameters.
  // False where the equations of the smooth step were not solved.
  bool solve(const VecX& lq, const VecX& lp, double lslip, ContactStepGradient& gradient, StepParameters& sums);
  // The gradient in q1 from that in the place of a contact's material point (place_change).
  VecX place_gradient(int contact, const Vec3& lplace);

 private:
  using Problem = ContactStepTangent::Problem;

  void set_matrices();
  void end_gradient(const Problem& problem, const VecX& v, VecX llambda, const VecX& lw, StepParameters& sums);
  void pass_pull(int end, const MatX& W, const VecX& lp);
  void law_gradient(const Problem& problem, const VecX& lc, VecX& lbase, VecX& ldy);

  const Scene* scene_;
  ContactStepTangent tangent_;
  StepAdjoint adjoint_;
  // The changes of the rows W0 and W1 per unit of q0, and of W1 per unit of q1, each (nv, rows).
  std::vector<MatX> W0_of_q0_, W1_of_q0_, W1_of_q1_;
  // Of ContactStepTangent::row_changes: per unit of q0, q1, the velocity, the length, the time, the anchors.
  MatX y_of_q0_, y_of_q1_, y_of_v_, y_of_anchors_, y_of_joints_;
  VecX y_of_h_, y_of_t_;
  // Of the velocities that surfaces have of themselves in the rows at the end: per unit of q0, q1, the time there.
  MatX own_of_q0_, own_of_q1_;
  VecX own_of_t_;
  // Gradients on the way: in q0, q1, p before the velocity impulse, W1, the changes of the rows.
  VecX lq0_, lq1_, lp_minus_, ldy_;
  MatX lW1_;
  double lh_ = 0.0, lt_ = 0.0;
  VecX lmu_, work_;
};

}  // namespace contactvi

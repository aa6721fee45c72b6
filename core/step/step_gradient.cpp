#include "step/step_gradient.hpp"

#include "base/refusal.hpp"
#include "step/public_tangent.hpp"

namespace contactvi {

StepGradient pull_back_step(const Tree& tree, const VecX& q0, const VecX& x0, StateKind kind, double h,
                            const StepInputs& inputs, int stages, double tol, const VecX& lq, const VecX& lx) {
  const int n = tree.nv;
  Integrator integrator(tree, stages, tol, kStepIterations);
  PublicStep step(tree, q0, x0, kind, h, inputs, integrator);
  StepAdjoint adjoint(tree, stages);
  step.give(adjoint);
  StepGradient result{VecX(n), VecX(n), VecX(n), 0.0, StepParameters(tree)};
  VecX q = lq, p = lx;
  to_engine_gradient(tree, adjoint, step.equations(), step.end(), q, p, result.parameters);
  if (!adjoint.solve(q, p, result.q, result.x, result.h, result.tau))
    throw Refusal("The derivative of the step was not solved", "adjoint equations with a solution", "none",
                  "Use a smaller dt");
  adjoint.add_parameters(result.parameters);
  to_public_gradient(tree, adjoint, step.start(), result.q, result.x, result.parameters);
  return result;
}

}  // namespace contactvi

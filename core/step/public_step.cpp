#include "step/public_step.hpp"

#include "base/refusal.hpp"
#include "model/coordinates.hpp"

namespace contactvi {

PublicStep::PublicStep(const Tree& tree, const VecX& q0, const VecX& x0, StateKind kind, double h,
                       const StepInputs& inputs, Integrator& integrator)
    : q0(q0),
      x0(x0),
      q1(tree.nq),
      x1(tree.nv),
      v0(tree.nv),
      p0(tree.nv),
      v1(tree.nv),
      p1(tree.nv),
      kind_(kind),
      h_(h),
      inputs_(inputs),
      integrator_(&integrator) {
  integrator_->start_anew();
  integrator_->set_time(inputs.time);
  integrator_->set_servo(inputs.servo.any ? &inputs.servo : nullptr);
  VecX other = x0;
  public_to_engine(tree, q0, other);
  if (kind == StateKind::kVelocity) {
    v0 = other;
    VecX G(tree.nv);
    integrator_->dynamics(q0, v0, p0, G);
  } else {
    p0 = other;
    if (!integrator_->node_velocity(q0, p0, v0)) throw Error("the mass matrix is not positive definite");
  }
  // To rounding, which may be out of reach: then from a solution to the tolerance, or that itself.
  if (!integrator_->solve_closely(q0, p0, h, inputs.tau) &&
      (!integrator_->solve(q0, p0, h, inputs.tau) ||
       (!integrator_->solve_closely(q0, p0, h, inputs.tau) && !integrator_->solve(q0, p0, h, inputs.tau))))
    throw Refusal("The step was not solved", "stage iterations that converge", integrator_->why(), "Use a smaller dt");
  integrator_->finish(q1, p1);
  if (!integrator_->node_velocity(q1, p1, v1)) throw Error("the mass matrix is not positive definite");
  x1 = kind == StateKind::kVelocity ? v1 : p1;
  engine_to_public(tree, q1, x1);
}

}  // namespace contactvi

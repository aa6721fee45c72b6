#include "sensitivity/linear_contact_step.hpp"

#include "base/refusal.hpp"
#include "contact/contact_step.hpp"
#include "model/coordinates.hpp"
#include "sensitivity/contact_step_tangent.hpp"
#include "step/public_tangent.hpp"

namespace contactvi {

namespace {

// A state with what the engine has of it.
struct State {
  StateKind kind;
  VecX q, x, v, p;
  StateView view() const { return {kind, q, x, v, p}; }
};

State start_of(const Scene& scene, Integrator& masses, const VecX& q, const VecX& x, StateKind kind) {
  State s{kind, q, x, x, x};
  public_to_engine(scene.tree, q, s.v);
  s.p = s.v;
  VecX G(scene.tree.nv);
  if (kind == StateKind::kVelocity) {
    masses.dynamics(q, s.v, s.p, G);
  } else if (!masses.node_velocity(q, s.p, s.v)) {
    throw Error("the mass matrix is not positive definite");
  }
  return s;
}

ContactStepRecord solve(const Scene& scene, const State& start, double h, const StepInputs& inputs,
                        const Servo* servo) {
  Guards guards(scene);
  ContactStep step(scene, guards, guards.manifolds());
  step.set_time(inputs.time);
  step.set_servo(servo);
  step.set_nominal(h);
  step.restart();
  step.invalidate();
  if (!step.solve(start.q, start.p, h, inputs.tau))
    throw Refusal("The step was not solved", "impulses that satisfy the constraints", step.why(), "Use a smaller dt");
  return step.record();
}

}  // namespace

LinearStep linearize_contact_step(const Scene& scene, const VecX& q0, const VecX& x0, StateKind kind, double h,
                                  const StepInputs& inputs) {
  const Tree& tree = scene.tree;
  const int n = tree.nv;
  const Servo* servo = inputs.servo.any ? &inputs.servo : nullptr;
  Integrator masses(tree, 1, 1e-12, 1);
  StepTangent momenta(tree, 1);
  const State start = start_of(scene, masses, q0, x0, kind);
  const ContactStepRecord record = solve(scene, start, h, inputs, servo);
  State end{kind, record.q1, record.v1, record.v1, record.p1};
  if (kind == StateKind::kMomentum) end.x = record.p1;
  engine_to_public(tree, end.q, end.x);
  ContactStepTangent tangent(scene);
  tangent.take(record, inputs.tau, servo);
  LinearStep result;
  result.q1 = end.q;
  result.x1 = end.x;
  VecX dq(n), dx(n);
  const auto to_engine = [&](VecX& q, VecX& p) { to_engine_direction(tree, momenta, start.view(), q, p); };
  fill_columns<ContactStepDirection>(result, n, to_engine, [&](const ContactStepDirection& direction, auto&& column) {
    tangent.solve(direction, dq, dx);
    to_public_direction(tree, momenta, masses, end.view(), dq, dx);
    column.head(n) = dq;
    column.tail(n) = dx;
  });
  return result;
}

}  // namespace contactvi

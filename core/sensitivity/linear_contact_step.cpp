#include "sensitivity/linear_contact_step.hpp"

#include "base/refusal.hpp"
#include "contact/contact_step.hpp"
#include "model/coordinates.hpp"
#include "sensitivity/held_step_tangent.hpp"
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

// The joints with friction, as they stick and slide at the start of a run from there.
std::vector<FrictionJoint> joints_at(const Scene& scene, Guards& guards, const State& start, const StepInputs& inputs,
                                     Integrator& integrator) {
  ContactStep step(scene, guards, guards.manifolds());
  integrator.set_time(inputs.time);
  integrator.set_servo(inputs.servo.any ? &inputs.servo : nullptr);
  settle_joints(step.friction_joints(), start.q, start.v);
  ContactStep::Forces forces;
  if (!step.forces_at(integrator, start.q, start.v, inputs.time, inputs.tau, {}, forces))
    throw Refusal("The step was not solved", "forces that satisfy the constraints", "none", "Use another start");
  begin_joint_slips(step.friction_joints(), step.of_joints(forces.a), kBegins * forces.largest);
  return step.friction_joints();
}

// All columns, by a tangent that has taken the step.
template <class Tangent>
LinearStep all_columns(const Tree& tree, Integrator& masses, const StateView& start, const StateView& end,
                       Tangent& tangent) {
  const int n = tree.nv;
  StepTangent momenta(tree, 1);
  LinearStep result;
  result.q1 = end.q;
  result.x1 = end.x;
  VecX dq(n), dx(n);
  const auto to_engine = [&](VecX& q, VecX& p) { to_engine_direction(tree, momenta, start, q, p); };
  fill_columns<ContactStepDirection>(result, n, to_engine, [&](const ContactStepDirection& direction, auto&& column) {
    tangent.solve(direction, dq, dx);
    to_public_direction(tree, momenta, masses, end, dq, dx);
    column.head(n) = dq;
    column.tail(n) = dx;
  });
  return result;
}

}  // namespace

LinearStep linearize_contact_step(const Scene& scene, const VecX& q0, const VecX& x0, StateKind kind, double h,
                                  const StepInputs& inputs) {
  const Tree& tree = scene.tree;
  const Servo* servo = inputs.servo.any ? &inputs.servo : nullptr;
  Integrator masses(tree, 1, 1e-12, 1);
  const State start = start_of(scene, masses, q0, x0, kind);
  const ContactStepRecord record = solve(scene, start, h, inputs, servo);
  State end{kind, record.q1, record.v1, record.v1, record.p1};
  if (kind == StateKind::kMomentum) end.x = record.p1;
  engine_to_public(tree, end.q, end.x);
  Kinks kinks(false);
  ContactStepTangent tangent(scene, kinks);
  tangent.take(record, inputs.tau, servo);
  return all_columns(tree, masses, start.view(), end.view(), tangent);
}

LinearStep linearize_held_step(const Scene& scene, const VecX& q0, const VecX& x0, StateKind kind, double h,
                               const StepInputs& inputs, int stages, double tol) {
  Integrator integrator(scene.tree, stages, tol, kStepIterations, true);
  Guards guards(scene);
  PersistentRows rows(guards, scene.tree.nv);
  const std::vector<PersistentContact> none;
  std::vector<FrictionJoint> joints;
  if (!scene.tree.elements.friction_dofs.empty()) {
    Integrator masses(scene.tree, 1, 1e-12, 1);
    joints = joints_at(scene, guards, start_of(scene, masses, q0, x0, kind), inputs, integrator);
    rows.set(none, joints, 2 * stages + 1);
    integrator.hold(&rows);
  }
  PublicStep step(scene.tree, q0, x0, kind, h, inputs, integrator);
  HeldStepRecord record = held_step_record(integrator, step.q0, step.p0);
  record.joints = joints;
  Kinks kinks(false);
  HeldStepTangent tangent(scene, stages, 1, kinks);
  tangent.take(record, inputs.tau, integrator.servo());
  return all_columns(scene.tree, integrator, step.start(), step.end(), tangent);
}

}  // namespace contactvi

#include "step/linearize.hpp"

#include "base/refusal.hpp"
#include "model/coordinates.hpp"

namespace contactvi {

namespace {

// States of one scene in public coordinates, with their derivatives in the engine's.
class States {
 public:
  States(const Tree& tree, StateKind kind, StepEquations& equations, StepTangent& tangent)
      : tree_(tree), kind_(kind), equations_(equations), tangent_(tangent) {}

  // Engine momentum and velocity of a public state.
  void read(const VecX& q, const VecX& x, VecX& v, VecX& p) {
    VecX other = x;
    public_to_engine(tree_, q, other);
    v.resize(tree_.nv);
    p.resize(tree_.nv);
    VecX G(tree_.nv);
    if (kind_ == StateKind::kVelocity) {
      v = other;
      equations_.dynamics(q, v, p, G);
      return;
    }
    p = other;
    if (!equations_.node_velocity(q, p, v)) throw Error("the mass matrix is not positive definite");
  }
  // (dq, dp) of the engine for a public direction (dq, dx) at (q, x).
  void to_engine(const VecX& q, const VecX& x, const VecX& v, VecX& dq, VecX& dx) {
    public_to_engine(tree_, q, dq);
    public_to_engine_tangent(tree_, q, dq, x, dx);
    if (kind_ == StateKind::kMomentum) return;
    VecX dp(tree_.nv);
    tangent_.momentum(q, v, dq, dx, dp);
    dx = dp;
  }
  // The reverse, at the engine's (q, v, p).
  void to_public(const VecX& q, const VecX& v, const VecX& p, VecX& dq, VecX& dp) {
    if (kind_ == StateKind::kVelocity) {
      VecX moved(tree_.nv);
      tangent_.momentum(q, v, dq, VecX::Zero(tree_.nv), moved);
      dp -= moved;
      equations_.place_node(q);
      equations_.solve_mass(dp);
    }
    engine_to_public_tangent(tree_, q, dq, kind_ == StateKind::kVelocity ? v : p, dp);
    engine_to_public(tree_, q, dq);
  }

 private:
  const Tree& tree_;
  StateKind kind_;
  StepEquations& equations_;
  StepTangent& tangent_;
};

}  // namespace

LinearStep linearize_step(const Tree& tree, const VecX& q0, const VecX& x0, StateKind kind, double h,
                          const StepInputs& inputs, int stages, double tol) {
  const int n = tree.nv;
  Integrator integrator(tree, stages, tol, 200);
  integrator.set_time(inputs.time);
  const Servo* servo = inputs.servo.any ? &inputs.servo : nullptr;
  integrator.set_servo(servo);
  StepTangent tangent(tree, stages);
  States states(tree, kind, integrator, tangent);
  VecX v0, p0, v1(n), p1(n);
  LinearStep result;
  states.read(q0, x0, v0, p0);
  // To the tolerance first, then to rounding from there, which may be out of reach.
  if (!integrator.solve(q0, p0, h, inputs.tau) ||
      (!integrator.solve_closely(q0, p0, h, inputs.tau) && !integrator.solve(q0, p0, h, inputs.tau)))
    throw Refusal("The step was not solved", "stage iterations that converge", integrator.why(), "Use a smaller dt");
  result.q1.resize(tree.nq);
  integrator.finish(result.q1, p1);
  tangent.take(q0, p0, h, inputs.tau, inputs.time, servo, integrator.velocities());
  if (!integrator.node_velocity(result.q1, p1, v1)) throw Error("the mass matrix is not positive definite");
  result.x1 = kind == StateKind::kVelocity ? v1 : p1;
  engine_to_public(tree, result.q1, result.x1);
  result.A.resize(2 * n, 2 * n);
  result.B.resize(2 * n, n);
  result.h.resize(2 * n);
  StepDirection direction;
  VecX dq(n), dx(n);
  const auto solve = [&](auto&& column) {
    if (!tangent.solve(direction, dq, dx))
      throw Refusal("The derivative of the step was not solved", "tangent equations with a solution", "none",
                    "Use a smaller dt");
    states.to_public(result.q1, v1, p1, dq, dx);
    column.head(n) = dq;
    column.tail(n) = dx;
  };
  for (int k = 0; k < 2 * n; ++k) {
    direction.q = VecX::Zero(n);
    direction.p = VecX::Zero(n);
    (k < n ? direction.q[k] : direction.p[k - n]) = 1.0;
    states.to_engine(q0, x0, v0, direction.q, direction.p);
    solve(result.A.col(k));
  }
  direction = StepDirection();
  for (int k = 0; k < n; ++k) {
    direction.tau = VecX::Zero(n);
    direction.tau[k] = 1.0;
    solve(result.B.col(k));
  }
  direction = StepDirection();
  direction.h = 1.0;
  solve(result.h);
  return result;
}

LinearForces linearize_forces(const Tree& tree, const VecX& q, const VecX& v, const StepInputs& inputs) {
  const int n = tree.nv;
  VecX w = v;
  public_to_engine(tree, q, w);
  ForceField field(tree);
  ForceTangent tangent(tree);
  LinearForces result;
  VecX f = VecX::Zero(n), size = VecX::Zero(n), dV = VecX::Zero(n), stiffness = VecX::Zero(n);
  field.add(inputs.time, q, w, f, size);
  add_spring_forces(tree, q, dV);
  VecX damping = tree.damping;
  const Servo& servo = inputs.servo;
  for (const Joint& joint : tree.joints) {
    if (joint.type != JointType::kSpherical) stiffness.segment(joint.iv, joint.nv).setConstant(joint.stiffness);
    const int d = joint.iv;
    if (!servo.any || joint.nv != 1) continue;
    f[d] += servo.feed[d] + servo.kd[d] * servo.v_ref[d];
    if (servo.kp[d] != 0.0) f[d] += servo.kp[d] * joint_error(joint, q, servo.q_ref[d]);
    stiffness[d] += servo.kp[d];
    damping[d] += servo.kd[d];
  }
  f -= dV + damping.cwiseProduct(w);
  result.f = f;
  engine_to_public(tree, q, result.f);
  result.f_q.resize(n, n);
  result.f_v.resize(n, n);
  VecX dq(n), dw(n), df(n);
  for (int k = 0; k < 2 * n; ++k) {
    dq.setZero();
    dw.setZero();
    (k < n ? dq[k] : dw[k - n]) = 1.0;
    public_to_engine(tree, q, dq);
    public_to_engine_tangent(tree, q, dq, v, dw);
    df = -stiffness.cwiseProduct(dq) - damping.cwiseProduct(dw);
    for (const Joint& joint : tree.joints)
      if (joint.type == JointType::kSpherical && joint.stiffness != 0)
        df.segment<3>(joint.iv) -=
            joint.stiffness * (so3_right_jacobian_inverse(spring_deflection(tree, joint, q)) * dq.segment<3>(joint.iv));
    tangent.add(inputs.time, q, w, dq, dw, df);
    engine_to_public_tangent(tree, q, dq, f, df);
    if (k < n) {
      result.f_q.col(k) = df;
    } else {
      result.f_v.col(k - n) = df;
    }
  }
  return result;
}

}  // namespace contactvi

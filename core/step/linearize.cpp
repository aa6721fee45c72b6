#include "step/linearize.hpp"

#include "base/refusal.hpp"
#include "model/coordinates.hpp"
#include "step/lost_velocity.hpp"
#include "step/public_tangent.hpp"

namespace contactvi {

namespace {

// The columns of the engine's derivative by q0, x0, tau and h become public ones.
void to_public(const Tree& tree, const PublicStep& step, const MatX& matrix, LinearStep& result) {
  const int n = tree.nv;
  result.A = matrix.leftCols(2 * n);
  result.B = matrix.middleCols(2 * n, n);
  result.h = matrix.col(3 * n);
  if (tree.split.empty()) return;
  VecX dq(n), dx(n);
  for (int k = 0; k < 2 * n; ++k) {
    dq.setZero();
    dx.setZero();
    (k < n ? dq[k] : dx[k - n]) = 1.0;
    public_to_engine(tree, step.q0, dq);
    public_to_engine_tangent(tree, step.q0, dq, step.x0, dx);
    auto column = result.A.col(k);
    column.setZero();
    for (int d = 0; d < n; ++d) {
      if (dq[d] != 0.0) column += dq[d] * matrix.col(d);
      if (dx[d] != 0.0) column += dx[d] * matrix.col(n + d);
    }
  }
  const VecX& x1 = step.kind() == StateKind::kVelocity ? step.v1 : step.p1;
  const auto turn = [&](auto&& column) {
    dq = column.head(n);
    dx = column.tail(n);
    engine_to_public_tangent(tree, step.q1, dq, x1, dx);
    engine_to_public(tree, step.q1, dq);
    column.head(n) = dq;
    column.tail(n) = dx;
  };
  for (int k = 0; k < 2 * n; ++k) turn(result.A.col(k));
  for (int k = 0; k < n; ++k) turn(result.B.col(k));
  turn(result.h);
}

}  // namespace

StepLinearizer::StepLinearizer(const Tree& tree, int stages, double tol)
    : tree_(&tree), stages_(stages), integrator_(tree, stages, tol, kStepIterations) {}

void StepLinearizer::make_step(const VecX& q0, const VecX& x0, StateKind kind, double h, const StepInputs& inputs) {
  step_.emplace(*tree_, q0, x0, kind, h, inputs, integrator_);
  result_.q1 = step_->q1;
  result_.x1 = step_->x1;
}

const LinearStep& StepLinearizer::solve(const VecX& q0, const VecX& x0, StateKind kind, double h,
                                        const StepInputs& inputs) {
  make_step(q0, x0, kind, h, inputs);
  const bool velocity = kind == StateKind::kVelocity;
  std::unique_ptr<StepMap>& map = maps_[velocity ? 0 : 1];
  if (!map) map = std::make_unique<StepMap>(*tree_, stages_, velocity);
  // Of coupled joints the public momentum is another one than the step's.
  if ((velocity || tree_->followers.empty()) && map->take(step_->solution())) {
    to_public(*tree_, *step_, map->matrix(), result_);
  } else {
    solve_columns();
  }
  return result_;
}

const LinearStep& StepLinearizer::solve_by_columns(const VecX& q0, const VecX& x0, StateKind kind, double h,
                                                   const StepInputs& inputs) {
  make_step(q0, x0, kind, h, inputs);
  solve_columns();
  return result_;
}

void StepLinearizer::solve_columns() {
  const Tree& tree = *tree_;
  const int n = tree.nv;
  PublicStep& step = *step_;
  StepTangent tangent(tree, stages_);
  step.give(tangent);
  VecX dq(n), dx(n);
  const auto to_engine = [&](VecX& q, VecX& p) { to_engine_direction(tree, tangent, step.start(), q, p); };
  fill_columns<StepDirection>(result_, n, to_engine, [&](const StepDirection& direction, auto&& column) {
    if (!tangent.solve(direction, dq, dx))
      throw Refusal("The derivative of the step was not solved", "tangent equations with a solution", "none",
                    "Use a smaller dt");
    to_public_direction(tree, tangent, step.equations(), step.end(), dq, dx);
    column.head(n) = dq;
    column.tail(n) = dx;
  });
}

double StepLinearizer::lost_velocity() { return contactvi::lost_velocity(integrator_, step_->q0).share; }

VecX passive_forces(const Tree& tree, const VecX& q, const VecX& v, double t) {
  VecX w = v, f = VecX::Zero(tree.nv), size = VecX::Zero(tree.nv), dV = VecX::Zero(tree.nv);
  public_to_engine(tree, q, w);
  ForceField(tree).add(t, q, w, f, size);
  add_spring_forces(tree, q, dV);
  f -= dV + tree.damping.cwiseProduct(w);
  engine_to_public(tree, q, f);
  return f;
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
  tangent.take(inputs.time, q, w);
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
    tangent.add(dq, dw, df);
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

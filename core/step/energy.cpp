#include "step/energy.hpp"

#include <algorithm>
#include <limits>
#include <vector>

#include "base/reduction.hpp"
#include "model/constraint_tangent.hpp"
#include "model/coordinates.hpp"

namespace contactvi {

namespace {

Twist operator+(const Twist& a, const Twist& b) { return {a.ang + b.ang, a.lin + b.lin}; }

// Motion of a body at (q, v), in its own frame.
struct BodyState {
  Mat3 R;  // in the parent
  Vec3 r;
  Twist inherited;  // velocity of the parent's frame, carried here
  Twist velocity;
  Vec3 gravity;
};

Twist to_child(const BodyState& body, const Twist& v) {
  return {body.R.transpose() * v.ang, body.R.transpose() * (v.lin + v.ang.cross(body.r))};
}

Twist joint_twist(const Joint& joint, const VecCRef& w) {
  const Vec3 zero = Vec3::Zero();
  switch (joint.type) {
    case JointType::kPrismatic:
      return {zero, w[joint.iv] * Vec3::UnitZ()};
    case JointType::kHelical:
      return {w[joint.iv] * Vec3::UnitZ(), joint.pitch * w[joint.iv] * Vec3::UnitZ()};
    case JointType::kTranslation:
      return {zero, w.segment<3>(joint.iv)};
    case JointType::kSpherical:
      return {w.segment<3>(joint.iv), zero};
    default:
      return {w[joint.iv] * Vec3::UnitZ(), zero};
  }
}

Wrench momentum(const Joint& joint, const Twist& v) {
  return {joint.inertia * v.ang + joint.first_moment.cross(v.lin),
          joint.mass * v.lin - joint.first_moment.cross(v.ang)};
}

double project(const Joint& joint, const Wrench& f, int d) {
  switch (joint.type) {
    case JointType::kPrismatic:
      return f.lin.z();
    case JointType::kHelical:
      return f.ang.z() + joint.pitch * f.lin.z();
    case JointType::kTranslation:
      return f.lin[d];
    case JointType::kSpherical:
      return f.ang[d];
    default:
      return f.ang.z();
  }
}

std::vector<BodyState> body_states(const Tree& tree, const Placements& at, const VecCRef& v) {
  std::vector<BodyState> bodies(tree.joints.size());
  for (std::size_t i = 0; i < bodies.size(); ++i) {
    const Joint& joint = tree.joints[i];
    BodyState& body = bodies[i];
    body.R = at.R[i];
    body.r = at.r[i];
    body.inherited = {Vec3::Zero(), Vec3::Zero()};
    if (joint.parent >= 0) body.inherited = to_child(body, bodies[joint.parent].velocity);
    body.velocity = body.inherited + joint_twist(joint, v);
    body.gravity = at.R_W[i].transpose() * tree.gravity;
  }
  return bodies;
}

// Velocity-dependent accelerations of the bodies (without joint accelerations and gravity): derivatives of the
// velocity's components in the body frame.
void bias_accelerations(const Tree& tree, const std::vector<BodyState>& bodies, const VecCRef& v,
                        std::vector<Twist>& bias) {
  for (std::size_t i = 0; i < tree.joints.size(); ++i) {
    const BodyState& body = bodies[i];
    bias[i] = cross(body.inherited, joint_twist(tree.joints[i], v));
    if (tree.joints[i].parent >= 0) bias[i] = bias[i] + to_child(body, bias[tree.joints[i].parent]);
  }
}

// a = M^-1 (-C v - dV/dq), by the backward pass of the recursive Newton-Euler algorithm. force: -dV/dq on entry, a on
// return.
void free_acceleration(const Tree& tree, const std::vector<BodyState>& bodies, const std::vector<Twist>& bias,
                       const VecCRef& v, StepEquations& equations, const VecX& armature, VecRef force) {
  std::vector<Wrench> f(tree.joints.size());
  for (std::size_t i = 0; i < tree.joints.size(); ++i) {
    const Wrench h = momentum(tree.joints[i], bodies[i].velocity), m = momentum(tree.joints[i], bias[i]);
    const Twist& w = bodies[i].velocity;
    f[i] = {m.ang + w.ang.cross(h.ang) + w.lin.cross(h.lin), m.lin + w.ang.cross(h.lin)};
  }
  for (int i = static_cast<int>(tree.joints.size()) - 1; i >= 0; --i) {
    const Joint& joint = tree.joints[i];
    const BodyState& body = bodies[i];
    for (int d = 0; d < joint.nv; ++d) force[joint.iv + d] -= project(joint, f[i], d);
    if (joint.type == JointType::kSpherical) {
      const Vec3 omega = v.segment<3>(joint.iv);
      force.segment<3>(joint.iv) -= omega.cross(armature.segment<3>(joint.iv).cwiseProduct(omega));
    }
    if (joint.parent < 0) continue;
    const Vec3 lin = body.R * f[i].lin;
    f[joint.parent].lin += lin;
    f[joint.parent].ang += body.R * f[i].ang + body.r.cross(lin);
  }
  equations.solve_mass(force);
}

// d/dt of v.dT/dq - dV_gravity/dt along q' = v, v' = a.
double power_rate(const Tree& tree, const std::vector<BodyState>& bodies, const std::vector<Twist>& bias,
                  const VecCRef& v, const VecCRef& a) {
  const std::size_t n = tree.joints.size();
  std::vector<Twist> rate(n), bias_rate(n);  // derivatives of the velocities and of the bias accelerations
  double sum = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const Joint& joint = tree.joints[i];
    const BodyState& body = bodies[i];
    const Twist sv = joint_twist(joint, v), sa = joint_twist(joint, a);
    Twist inherited_rate = cross(body.inherited, sv);
    bias_rate[i] = cross(body.inherited, sa);
    if (joint.parent >= 0) {
      inherited_rate = inherited_rate + to_child(body, rate[joint.parent]);
      bias_rate[i] =
          bias_rate[i] + to_child(body, bias_rate[joint.parent]) + cross(to_child(body, bias[joint.parent]), sv);
    }
    bias_rate[i] = bias_rate[i] + cross(inherited_rate, sv);
    rate[i] = inherited_rate + sa;
    sum += dot(momentum(joint, bias[i]), rate[i]) + dot(momentum(joint, body.velocity), bias_rate[i]);
    const Twist& w = body.velocity;
    const Vec3 lin = rate[i].lin + w.ang.cross(w.lin);
    sum += body.gravity.dot(joint.mass * lin + rate[i].ang.cross(joint.first_moment) +
                            w.ang.cross(w.ang.cross(joint.first_moment)));
  }
  return sum;
}

double spring_power_rate(const Tree& tree, const VecCRef& q, const VecCRef& v, const VecCRef& a) {
  double sum = 0;
  for (const Joint& joint : tree.joints) {
    if (joint.stiffness == 0) continue;
    const Vec3 deflection = spring_deflection(tree, joint, q);
    Vec3 w = Vec3::Zero(), wdot = Vec3::Zero();
    w.head(joint.nv) = v.segment(joint.iv, joint.nv);
    wdot.head(joint.nv) = a.segment(joint.iv, joint.nv);
    const Vec3 rate = joint.type == JointType::kSpherical ? Vec3(so3_right_jacobian_inverse(deflection) * w) : w;
    sum += joint.stiffness * (rate.dot(w) + deflection.dot(wdot));
  }
  return sum;
}

// From the acceleration a without constraints to that with them. Returns lambda.(W^T a) of their forces lambda. The
// node of the equations is at q.
double constrain_acceleration(StepEquations& equations, const VecCRef& q, const VecCRef& v, double t, VecX& a) {
  const Tree& tree = equations.tree();
  const int rows = tree.elements.constraint_rows;
  if (rows == 0) return 0.0;
  ConstraintTangent constraints(tree);
  constraints.take(q, t);
  const VecX none(0), turning = constraints.turning(v);
  VecX force(rows);
  const MatX& W = constraints.gradients();
  MatX MinvW = W;
  equations.solve_masses(MinvW);
  Reduction reduction;
  reduction.set(W.transpose() * MinvW, rows);
  reduction.right_side(W.transpose() * a + turning);
  reduction.complete(none, force);
  a.noalias() += MinvW * force;
  return -force.dot(turning);
}

void add_servo(const Tree& tree, const Servo* servo, double t, const VecCRef& q, const VecCRef& v, VecRef f) {
  if (servo == nullptr || !servo->any) return;
  const VecX references = servo->moving != nullptr ? (*servo->moving)(t) : VecX();
  for (const Joint& joint : tree.joints) {
    if (joint.nv != 1) continue;
    const int d = joint.iv;
    if (servo->kp[d] != 0.0) f[d] += servo->kp[d] * joint_error(joint, q, servo->q_ref[d]);
    f[d] += servo->feed[d] + servo->kd[d] * (servo->v_ref[d] - v[d]);
    if (references.size() > 0) f[d] += servo->lead(references, d);
  }
}

}  // namespace

Energy energy(StepEquations& equations, const VecCRef& q, const VecCRef& p) {
  const Tree& tree = equations.tree();
  VecX v(tree.nv);
  if (!equations.node_velocity(q, p, v))
    return {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::quiet_NaN()};
  return energy(equations, q, p, v);
}

Energy energy(StepEquations& equations, const VecCRef& q, const VecCRef& p, const VecCRef& v) {
  Placements at(equations.tree());
  place(equations.tree(), q, at);
  return {0.5 * p.dot(v), total_potential(equations.tree(), equations.field(), at, q)};
}

double largest_turn(const Tree& tree, const VecCRef& v, double h) {
  double turn = 0.0;
  for (const Joint& joint : tree.joints) {
    const bool slides = joint.type == JointType::kPrismatic || joint.type == JointType::kTranslation;
    if (!slides) turn = std::max(turn, h * v.segment(joint.iv, joint.nv).norm());
  }
  return turn;
}

double modified_hamiltonian(StepEquations& equations, const VecCRef& q, const VecCRef& p, double h, double t) {
  const Tree& tree = equations.tree();
  const Energy H = energy(equations, q, p);
  if (equations.stages() > 1) return H.kinetic + H.potential;
  VecX v = p, P(tree.nv), G(tree.nv), dV = VecX::Zero(tree.nv), zero = VecX::Zero(tree.nv);
  equations.solve_mass(v);
  // At rest G is -dV/dq of gravity.
  equations.dynamics(q, zero, P, dV);
  dV = -dV;
  equations.dynamics(q, v, P, G);
  VecX springs = VecX::Zero(tree.nv);
  add_spring_forces(tree, q, springs);
  equations.field().add_gradient(q, springs);
  Placements at(tree);
  place(tree, q, at);
  const std::vector<BodyState> bodies = body_states(tree, at, v);
  std::vector<Twist> bias(tree.joints.size());
  bias_accelerations(tree, bodies, v, bias);
  VecX a = -dV - springs;
  free_acceleration(tree, bodies, bias, v, equations, tree.armature, a);
  const double forces_a = constrain_acceleration(equations, q, v, t, a);
  const double G_a = (G - springs).dot(a);
  const double dG_v = power_rate(tree, bodies, bias, v, a) - spring_power_rate(tree, q, v, a) -
                      equations.field().power_rate(q, v, a) - G_a;
  double bracket = 0;
  for (const Joint& joint : tree.joints) {
    if (joint.type != JointType::kSpherical) continue;
    bracket += p.segment<3>(joint.iv).dot(v.segment<3>(joint.iv).cross(Vec3(a.segment<3>(joint.iv))));
  }
  return H.kinetic + H.potential - h * h / 24.0 * (G_a - dG_v + bracket - forces_a);
}

void energy_gradient(StepEquations& equations, const VecCRef& q, const VecCRef& v, VecRef gradient) {
  const Tree& tree = equations.tree();
  VecX P(tree.nv), G(tree.nv);
  equations.dynamics(q, v, P, G);
  gradient.setZero();
  add_spring_forces(tree, q, gradient);
  equations.field().add_gradient(q, gradient);
  gradient -= G;
}

void forward_dynamics(StepEquations& equations, const VecCRef& q, const VecCRef& v, double t, const VecX& tau,
                      VecRef a) {
  const Tree& tree = equations.tree();
  Placements at(tree);
  place(tree, q, at);
  const std::vector<BodyState> bodies = body_states(tree, at, v);
  std::vector<Twist> bias(tree.joints.size());
  bias_accelerations(tree, bodies, v, bias);
  VecX springs = VecX::Zero(tree.nv);
  add_spring_forces(tree, q, springs);
  a = -springs;
  if (tree.has_damping) a -= tree.damping.cwiseProduct(v);
  if (tau.size() > 0) {
    VecX applied = tau;
    public_to_engine(tree, q, applied);
    a += applied;
  }
  add_servo(tree, equations.servo(), t, q, v, a);
  if (equations.field().any()) {
    VecX size = VecX::Zero(tree.nv);
    equations.field().add(t, q, v, a, size);
  }
  // Gravity acts like an acceleration of the world upwards.
  for (std::size_t i = 0; i < bodies.size(); ++i) bias[i].lin -= bodies[i].gravity;
  free_acceleration(tree, bodies, bias, v, equations, tree.armature, a);
}

Eigen::Matrix<double, 6, 1> spatial_momentum(const Tree& tree, const VecCRef& q, const VecCRef& v) {
  Placements at(tree);
  place(tree, q, at);
  const std::vector<BodyState> bodies = body_states(tree, at, v);
  Vec3 linear = Vec3::Zero(), angular = Vec3::Zero();
  for (std::size_t i = 0; i < bodies.size(); ++i) {
    const Wrench own = momentum(tree.joints[i], bodies[i].velocity);
    const Vec3 f = at.R_W[i] * own.lin;
    linear += f;
    angular += at.R_W[i] * own.ang + at.p_W[i].cross(f);
  }
  Eigen::Matrix<double, 6, 1> total;
  total << linear, angular;
  return total;
}

}  // namespace contactvi

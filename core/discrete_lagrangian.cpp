#include "discrete_lagrangian.hpp"

#include "coordinates.hpp"

namespace contactvi {

StepWorkspace::StepWorkspace(const Tree& tree)
    : kernel(tree),
      q_mid(tree.nq),
      P(tree.nv),
      dT(tree.nv),
      dV(tree.nv),
      force(tree.nv),
      magnitude(tree.nv),
      residual(tree.nv) {}

double add_springs(const Tree& tree, const VecCRef& q, VecRef dV) {
  double energy = 0;
  if (!tree.has_springs) return energy;
  for (const Joint& joint : tree.joints) {
    if (joint.stiffness == 0) continue;
    // On SO(3) the gradient of |log R|^2/2 is log R itself, because log R is an eigenvector of its Jacobian.
    const Vec3 deflection = spring_deflection(tree, joint, q);
    const bool three = joint.type == JointType::kTranslation || joint.type == JointType::kSpherical;
    for (int d = 0; d < (three ? 3 : 1); ++d) dV[joint.iv + d] += joint.stiffness * deflection[d];
    energy += 0.5 * joint.stiffness * deflection.squaredNorm();
  }
  return energy;
}

void residual(const Tree& tree, const VecCRef& q0, const VecCRef& p0, const VecCRef& v, double h, const VecX& tau,
              StepWorkspace& ws) {
  integrate(tree, q0, v, 0.5 * h, ws.q_mid);
  momentum_and_forces(tree, ws.q_mid, v, ws.kernel, ws.P, ws.dT, ws.dV);
  ws.magnitude = ws.dT.cwiseAbs() + ws.dV.cwiseAbs();
  if (tree.has_springs) {
    add_springs(tree, ws.q_mid, ws.dV);
    ws.magnitude += ws.dV.cwiseAbs();
  }
  ws.force = ws.dT - ws.dV;
  if (tree.has_damping) ws.force -= tree.damping.cwiseProduct(v);
  if (tau.size() > 0) {
    VecRef applied = ws.residual;
    applied = tau;
    public_to_engine(tree, ws.q_mid, applied);
    ws.force += applied;
    ws.magnitude += applied.cwiseAbs();
  }
  ws.residual = p0 - ws.P + (0.5 * h) * ws.force;
  for (const Joint& joint : tree.joints) {
    if (joint.type != JointType::kSpherical) continue;
    const int iv = joint.iv;
    const Vec3 xi = h * v.segment<3>(iv), half = 0.5 * xi;
    const Vec3 P = ws.P.segment<3>(iv), Q = ws.force.segment<3>(iv);
    const So3Coefficients full = so3_coefficients(xi.squaredNorm()), mid = so3_coefficients(half.squaredNorm());
    const Vec3 kicked = P + (0.5 * h) * so3_apply(half, mid.cos_t, mid.cub_t, Q);
    const Vec3 start = so3_apply(xi, 0.5, full.inv_t, kicked) - h * so3_apply(half, mid.sin_t, mid.cos_t, Q);
    ws.residual.segment<3>(iv) = p0.segment<3>(iv) - start;
  }
}

bool newton_matrix(const Tree& tree, double h, StepWorkspace& ws, TreeLu& matrix) {
  assemble_newton(tree, h, ws.P, ws.kernel, matrix);
  if (tree.has_damping)
    for (int k = 0; k < tree.nv; ++k) matrix.diagonal(k) += 0.5 * h * tree.damping[k];
  if (tree.has_springs)
    for (int k = 0; k < tree.nv; ++k) matrix.diagonal(k) += 0.25 * h * h * tree.joints[tree.dof_joint[k]].stiffness;
  return matrix.factor();
}

void end_momentum(const Tree& tree, const VecCRef& p0, const VecCRef& v, double h, const StepWorkspace& ws, VecRef p1) {
  p1 = p0 + h * ws.force;
  for (const Joint& joint : tree.joints) {
    if (joint.type != JointType::kSpherical) continue;
    const int iv = joint.iv;
    const Vec3 back = -h * v.segment<3>(iv), half = 0.5 * h * v.segment<3>(iv);
    const Vec3 Q = ws.force.segment<3>(iv);
    const So3Coefficients full = so3_coefficients(back.squaredNorm()), mid = so3_coefficients(half.squaredNorm());
    const Vec3 sum = p0.segment<3>(iv) + h * so3_apply(half, mid.sin_t, mid.cos_t, Q);
    p1.segment<3>(iv) = so3_apply(back, full.sin_t, full.cos_t, sum);
  }
}

double nonconservative_power(const Tree& tree, const VecX& v, const VecX& tau, const StepWorkspace& ws) {
  if (!tree.has_damping && tau.size() == 0) return 0.0;
  return v.dot(ws.force - ws.dT + ws.dV);  // dV holds the springs
}

}  // namespace contactvi

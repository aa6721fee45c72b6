#include "step/step_parameters.hpp"

namespace contactvi {

StepParameters::StepParameters(const Tree& tree)
    : inertia(Eigen::Matrix<double, Eigen::Dynamic, 10>::Zero(tree.joints.size(), 10)),
      armature(VecX::Zero(tree.nv)),
      damping(armature),
      rest(armature),
      stiffness(VecX::Zero(tree.joints.size())),
      kp(armature),
      kd(armature),
      q_ref(armature),
      v_ref(armature),
      feed(armature),
      gravity(Vec3::Zero()) {}

ParameterAdjoint::ParameterAdjoint(const Tree& tree) : tree_(&tree), bodies_(tree) {}

// A body's Lagrangian is m u^2/2 + u . (w x c) + w . I w/2 + g . (m p + R c) with the velocity u of its origin p, all
// but g and p in its frame. Its derivatives in (m, c, I) are differentiated along (dv, dq) = (P_bar, G_bar).
void ParameterAdjoint::add_state(const VecCRef& q, const VecCRef& v, const VecCRef& P_bar, const VecCRef& G_bar,
                                 StepParameters& sums) {
  bodies_.place(q);
  bodies_.move(v, G_bar, P_bar);
  for (int i = 0; i < static_cast<int>(tree_->joints.size()); ++i) {
    const Joint& joint = tree_->joints[i];
    const Mat3& R = bodies_.placements().R_W[i];
    const Vec3& p = bodies_.placements().p_W[i];
    const Twist &V = bodies_.speed(i), &D = bodies_[i], &dV = bodies_.speed_moved(i);
    const Vec3 p_moved = D.lin + D.ang.cross(p), speed = V.lin + V.ang.cross(p);
    const Vec3 speed_moved = dV.lin + dV.ang.cross(p) + V.ang.cross(p_moved);
    const Vec3 w = R.transpose() * V.ang, dw = R.transpose() * (dV.ang - D.ang.cross(V.ang));
    const Vec3 u = R.transpose() * speed, du = R.transpose() * (speed_moved - D.ang.cross(speed));
    const Vec3 fall = tree_->gravity;
    auto row = sums.inertia.row(i);
    row[0] += u.dot(du) + fall.dot(p_moved);
    const Vec3 moment = du.cross(w) + u.cross(dw) + R.transpose() * fall.cross(D.ang);
    for (int d = 0; d < 3; ++d) row[1 + d] += moment[d];
    int k = 4;
    for (int a = 0; a < 3; ++a)
      for (int b = a; b < 3; ++b) row[k++] += a == b ? w[a] * dw[a] : w[a] * dw[b] + dw[a] * w[b];
    sums.gravity += joint.mass * p_moved + D.ang.cross(R * joint.first_moment);
  }
  sums.armature += v.cwiseProduct(P_bar);
}

namespace {

// Calls visit(entry, dof, slope) for each entry of the parameters and each degree of freedom whose force at stage i of
// a step from q0 depends on it. Parameters: StepParameters, constant or not.
template <class Parameters, class Visit>
void each_force_parameter(const Tree& tree, const Stages& stages, const VecCRef& q0, int i, Parameters& all,
                          Visit visit) {
  const int S = stages.padded();
  const Servo* servo = stages.servo();
  for (int k = 0; k < static_cast<int>(tree.joints.size()); ++k) {
    const Joint& joint = tree.joints[k];
    const int iv = joint.iv;
    double X[3] = {0.0, 0.0, 0.0};
    for (int d = 0; d < joint.nv; ++d) {
      X[d] = stages.X()[(iv + d) * S + i];
      visit(all.damping[iv + d], iv + d, -stages.v()[(iv + d) * S + i]);
    }
    if (joint.type == JointType::kSpherical) {
      VecX q = q0;
      integrate_joint(joint, q0, X, q);
      const Vec3 deflection = spring_deflection(tree, joint, q);
      // A turn of the rest configuration by d changes the deflection by -J_l^-1 d.
      const Mat3 turn = joint.stiffness * so3_right_jacobian_inverse(deflection).transpose();
      for (int d = 0; d < 3; ++d) {
        visit(all.stiffness[k], iv + d, -deflection[d]);
        for (int e = 0; e < 3; ++e) visit(all.rest[iv + e], iv + d, turn(d, e));
      }
    } else {
      const Vec3 deflection = spring_deflection(tree, joint, q0);
      for (int d = 0; d < joint.nv; ++d) {
        visit(all.stiffness[k], iv + d, -(deflection[d] + X[d]));
        visit(all.rest[iv + d], iv + d, joint.stiffness);
      }
    }
    if (servo == nullptr || !servo->any || joint.nv != 1 || servo->holds(iv)) continue;
    visit(all.kp[iv], iv, joint_error(joint, q0, servo->q_ref[iv]) - X[0]);
    visit(all.kd[iv], iv, servo->v_ref[iv] - stages.v()[iv * S + i]);
    visit(all.q_ref[iv], iv, servo->kp[iv]);
    visit(all.v_ref[iv], iv, servo->kd[iv]);
    visit(all.feed[iv], iv, 1.0);
  }
}

}  // namespace

void ParameterAdjoint::add_forces(const Stages& stages, const VecCRef& q0, int i, const VecCRef& G_bar,
                                  StepParameters& sums) const {
  each_force_parameter(*tree_, stages, q0, i, sums,
                       [&](double& sum, int dof, double slope) { sum += slope * G_bar[dof]; });
}

ParameterTangent::ParameterTangent(const Tree& tree)
    : tree_(&tree), bodies_(tree), momentum_(tree.joints.size()), weight_(tree.joints.size()) {}

// With the axes S of a joint, the momentum H and the weight F of what it carries, and the twist V of its parent:
// P = S . H, and G = -(S x V) . H + S . F.
void ParameterTangent::add_state(const VecCRef& q, const VecCRef& v, const StepParameters& direction, VecRef dP,
                                 VecRef dG) {
  const VecX still = VecX::Zero(tree_->nv);
  bodies_.place(q);
  bodies_.move(v, still, still);
  const int count = static_cast<int>(tree_->joints.size());
  for (int i = 0; i < count; ++i) {
    const Joint& joint = tree_->joints[i];
    const Mat3& R = bodies_.placements().R_W[i];
    const Vec3& p = bodies_.placements().p_W[i];
    const auto change = direction.inertia.row(i);
    const double mass = change[0];
    const Vec3 moment(change[1], change[2], change[3]);
    Mat3 inertia;
    inertia << change[4], change[5], change[6], change[5], change[7], change[8], change[6], change[8], change[9];
    const Twist& V = bodies_.speed(i);
    const Vec3 w = R.transpose() * V.ang, u = R.transpose() * (V.lin + V.ang.cross(p));
    const Vec3 linear = R * (mass * u - moment.cross(w));
    momentum_[i] = {R * (inertia * w + moment.cross(u)) + p.cross(linear), linear};
    const Vec3 &fall = tree_->gravity, &more = direction.gravity;
    const Vec3 first = mass * p + R * moment, own = joint.mass * p + R * joint.first_moment;
    weight_[i] = {first.cross(fall) + own.cross(more), mass * fall + joint.mass * more};
  }
  const auto apply = [](const Twist& S, const Wrench& W) { return S.ang.dot(W.ang) + S.lin.dot(W.lin); };
  for (int i = count; i-- > 0;) {
    const Joint& joint = tree_->joints[i];
    for (int d = 0; d < joint.nv; ++d) {
      const Twist S = bodies_.axis(i, d);
      dP[joint.iv + d] += apply(S, momentum_[i]);
      dG[joint.iv + d] += apply(S, weight_[i]);
      if (joint.parent >= 0) dG[joint.iv + d] -= apply(cross(S, bodies_.speed(joint.parent)), momentum_[i]);
    }
    if (joint.parent < 0) continue;
    momentum_[joint.parent].ang += momentum_[i].ang;
    momentum_[joint.parent].lin += momentum_[i].lin;
    weight_[joint.parent].ang += weight_[i].ang;
    weight_[joint.parent].lin += weight_[i].lin;
  }
  dP += direction.armature.cwiseProduct(v);
}

void ParameterTangent::add_forces(const Stages& stages, const VecCRef& q0, int i, const StepParameters& direction,
                                  VecRef dG) const {
  each_force_parameter(*tree_, stages, q0, i, direction,
                       [&](double change, int dof, double slope) { dG[dof] += slope * change; });
}

}  // namespace contactvi

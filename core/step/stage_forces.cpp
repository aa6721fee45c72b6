// Stages: the forces beyond gravity, and their powers.
#include <algorithm>
#include <cmath>

#include "model/coordinates.hpp"
#include "step/stages.hpp"

namespace contactvi {

void Servo::refer(double t) {
  const VecX references = (*moving)(t);
  q_ref = references.head(kp.size());
  v_ref = references.tail(kp.size());
}

double Servo::lead(const VecX& references, int dof) const {
  return kp[dof] * (references[dof] - q_ref[dof]) + kd[dof] * (references[kp.size() + dof] - v_ref[dof]);
}

// The gains of servos are added to the stiffness and damping of their joints.
void Stages::set_servo(const Servo* servo) {
  const bool before = servo_ != nullptr && servo_->any, now = servo != nullptr && servo->any;
  servo_ = servo;
  if (!before && !now) return;
  for (const Joint& joint : tree_->joints)
    for (int d = joint.iv; d < joint.iv + joint.nv; ++d) {
      const bool ball = joint.type == JointType::kSpherical;
      const double stiffness = (ball ? 0.0 : joint.stiffness) + (now ? servo->kp[d] : 0.0);
      const double damping = tree_->damping[d] + (now ? servo->kd[d] : 0.0);
      if (stiffness == stiffness_[d] && damping == damping_[d]) continue;
      stiffness_[d] = stiffness;
      damping_[d] = damping;
      diagonal_h_ = std::numeric_limits<double>::quiet_NaN();
    }
}

void Stages::set_forces(const VecCRef& q0, const VecX& tau) {
  has_inputs_ = tau.size() > 0;
  const bool servo = servo_ != nullptr && servo_->any;
  const bool linear = tree_->has_springs || tree_->has_damping || servo;
  work_.stiffness = linear ? stiffness_ : nullptr;
  if (tree_->has_springs) {
    q0_ = q0;
    for (const Joint& joint : tree_->joints) {
      if (joint.stiffness == 0 || joint.type == JointType::kSpherical) continue;
      const Vec3 deflection = spring_deflection(*tree_, joint, q0);
      for (int d = 0; d < joint.nv; ++d) deflection_[joint.iv + d] = deflection[d];
    }
  }
  if (servo) {
    q0_ = q0;
    for (const Joint& joint : tree_->joints) {
      const int d = joint.iv;
      if (joint.nv != 1 || servo_->kp[d] == 0.0) continue;
      // The springs of the joint and of the servo act as one, with the mean of their deflections.
      const double own = joint.stiffness != 0.0 ? joint.stiffness * deflection_[d] : 0.0;
      deflection_[d] = (own - servo_->kp[d] * joint_error(joint, q0, servo_->q_ref[d])) / stiffness_[d];
    }
  }
  work_.tau = nullptr;
  const bool split = has_inputs_ && !tree_->split.empty();
  if (has_inputs_) {
    q0_ = q0;
    tau_ = tau;
    for (int d = 0; d < tree_->nv; ++d) input_[d] = tau[d];
    // The forces on split joints turn with the body: add_split_inputs() adds them at each stage.
    for (const SplitJoint& joint : tree_->split)
      for (int d = 0; d < (joint.planar ? 2 : 3); ++d) input_[joint.iv + d] = 0.0;
    work_.tau = input_;
  }
  if (servo) {
    if (!has_inputs_) std::fill_n(input_, tree_->nv, 0.0);
    for (int d = 0; d < tree_->nv; ++d) input_[d] += servo_->feed[d] + servo_->kd[d] * servo_->v_ref[d];
    work_.tau = input_;
  }
  if (field_.any()) q0_ = q0;
  if (leads()) {
    lead_.resize(tree_->nv, work_.s);
    for (int i = 0; i < work_.s; ++i) {
      const VecX references = (*servo_->moving)(time(i));
      for (int d = 0; d < tree_->nv; ++d) lead_(d, i) = servo_->lead(references, d);
    }
  }
  work_.extra = split || has_ball_springs_ || field_.any() || leads() ? &Stages::add_extra : nullptr;
}

double Stages::servo_torque(int d, int i) const {
  const Joint& joint = tree_->joints[tree_->dof_joint[d]];
  const int at = d * work_.S + i;
  double torque = servo_->feed[d] + servo_->kd[d] * (servo_->v_ref[d] - v_[at]);
  if (servo_->kp[d] != 0.0) torque += servo_->kp[d] * (joint_error(joint, q0_, servo_->q_ref[d]) - X_[at]);
  return leads() ? torque + lead_(d, i) : torque;
}

double Stages::input_power(int i) const {
  double total = element_input_[i];
  const int S = work_.S;
  if (work_.tau != nullptr)
    for (int d = 0; d < tree_->nv; ++d)
      total += (input_[d] + (has_inputs_ && !tree_->split.empty() ? applied_[d * S + i] : 0.0)) * v_[d * S + i];
  if (servo_ == nullptr || !servo_->any) return total;
  // input_ contains feed and kd v_ref, but not the parts of kp and of v.
  for (const Joint& joint : tree_->joints) {
    const int d = joint.iv;
    if (joint.nv != 1) continue;
    const double v = v_[d * S + i], kp = servo_->kp[d];
    if (kp != 0.0) total += kp * (joint_error(joint, q0_, servo_->q_ref[d]) - X_[d * S + i]) * v;
    total -= servo_->kd[d] * v * v;
    if (leads()) total += lead_(d, i) * v;
  }
  return total;
}

double Stages::dissipation(int i) const {
  double total = element_dissipation_[i];
  const int S = work_.S;
  if (tree_->has_damping)
    for (int d = 0; d < tree_->nv; ++d) total += tree_->damping[d] * v_[d * S + i] * v_[d * S + i];
  return total;
}

void Stages::add_extra(void* self) { static_cast<Stages*>(self)->add_forces(); }

void Stages::add_forces() {
  if (has_inputs_ && !tree_->split.empty()) add_split_inputs();
  if (has_ball_springs_) add_ball_springs();
  if (field_.any()) add_elements();
  if (leads()) add_lead();
}

void Stages::add_lead() {
  const int S = work_.S;
  for (int d = 0; d < tree_->nv; ++d)
    for (int i = 0; i < S; ++i) {
      const double torque = lead_(d, std::min(i, work_.s - 1));  // padding lanes repeat the last stage
      G_[d * S + i] += torque;
      magnitude_[d * S + i] += std::abs(torque);
    }
}

void Stages::add_elements() {
  const int S = work_.S, n = tree_->nv;
  for (int i = 0; i < work_.s; ++i) {
    configuration(q0_, i, q_stage_);
    for (int d = 0; d < n; ++d) v_stage_[d] = v_[d * S + i];
    force_.setZero();
    size_.setZero();
    field_.add(time(i), q_stage_, v_stage_, force_, size_);
    element_input_[i] = field_.input();
    element_dissipation_[i] = field_.dissipation();
    const int last = i + 1 == work_.s ? S : i + 1;  // padding lanes repeat the last stage
    for (int d = 0; d < n; ++d)
      for (int k = i; k < last; ++k) {
        G_[d * S + k] += force_[d];
        magnitude_[d * S + k] += size_[d];
      }
  }
}

void Stages::add_split_inputs() {
  const int S = work_.S;
  for (int i = 0; i < S; ++i) {
    for (const SplitJoint& joint : tree_->split) {
      const int iv = joint.iv, iq = joint.iq, turning = joint.planar ? 2 : 3;
      Vec3 force = Vec3::Zero();
      if (joint.planar) {
        const double angle = X_[(iv + 2) * S + i], c0 = q0_[iq + 2], s0 = q0_[iq + 3];
        const double c = c0 * std::cos(angle) - s0 * std::sin(angle), s = s0 * std::cos(angle) + c0 * std::sin(angle);
        force = Vec3(c * tau_[iv] - s * tau_[iv + 1], s * tau_[iv] + c * tau_[iv + 1], 0.0);
      } else {
        const Quat quat(q0_[iq + 6], q0_[iq + 3], q0_[iq + 4], q0_[iq + 5]);
        const Vec3 X(X_[(iv + 3) * S + i], X_[(iv + 4) * S + i], X_[(iv + 5) * S + i]);
        force = quat * (so3_exp(X) * tau_.segment<3>(iv));
      }
      for (int d = 0; d < turning; ++d) {
        const int at = (iv + d) * S + i;
        applied_[at] = force[d];
        G_[at] += force[d];
        magnitude_[at] += std::abs(force[d]);
      }
    }
  }
}

// On SO(3) the gradient of |log R|^2/2 is log R itself, because log R is an eigenvector of its Jacobian.
void Stages::add_ball_springs() {
  const int S = work_.S;
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical || joint.stiffness == 0) continue;
    const int iv = joint.iv;
    q_stage_ = q0_;
    for (int i = 0; i < S; ++i) {
      const Vec3 X(X_[iv * S + i], X_[(iv + 1) * S + i], X_[(iv + 2) * S + i]);
      const Quat start(q0_[joint.iq + 3], q0_[joint.iq], q0_[joint.iq + 1], q0_[joint.iq + 2]);
      q_stage_.segment<4>(joint.iq) = (start * so3_exp(X)).coeffs();
      const Vec3 deflection = spring_deflection(*tree_, joint, q_stage_);
      for (int d = 0; d < 3; ++d) {
        G_[(iv + d) * S + i] -= joint.stiffness * deflection[d];
        magnitude_[(iv + d) * S + i] += joint.stiffness * std::abs(deflection[d]);
      }
    }
  }
}

}  // namespace contactvi

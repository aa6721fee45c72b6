#include "step/force_adjoint.hpp"

#include <cmath>

namespace contactvi {

ForceAdjoint::ForceAdjoint(const Tree& tree, int stages)
    : tree_(&tree),
      field_(tree),
      s_(stages),
      q_(tree.nq),
      v_(tree.nv),
      dq_(VecX::Zero(tree.nv)),
      dv_(VecX::Zero(tree.nv)),
      df_(tree.nv),
      bar_(tree.nv) {
  for (const Joint& joint : tree.joints)
    if (joint.type == JointType::kSpherical && joint.stiffness != 0.0)
      springs_.push_back({joint.iv, std::vector<Mat3>(stages)});
  for (const SplitJoint& split : tree.split)
    inputs_.push_back({split.iv, split.iv + (split.planar ? 2 : 3), split.planar ? 2 : 3, Vec3::Zero(),
                       std::vector<Mat3>(stages, Mat3::Identity())});
  if (!field_.any()) return;
  slope_q_.assign(stages, MatX(tree.nv, tree.nv));
  slope_v_ = slope_q_;
}

Vec3 ForceAdjoint::get(const double* array, int dof, int i) const {
  return {array[dof * S_ + i], array[(dof + 1) * S_ + i], array[(dof + 2) * S_ + i]};
}

// Padding lanes repeat the last stage.
void ForceAdjoint::add_to(double* array, int dof, int i, double x) const {
  for (int k = i; k < (i + 1 == s_ ? S_ : i + 1); ++k) array[dof * S_ + k] += x;
}

void ForceAdjoint::take(SolvedStep& step) {
  const Stages& stages = step.stages();
  S_ = stages.padded();
  stiffness_ = stages.stiffness();
  damping_ = stages.damping();
  take_springs(step);
  take_inputs(step);
  if (field_.any()) take_elements(step);
}

void ForceAdjoint::take_springs(SolvedStep& step) {
  for (Spring& spring : springs_) {
    const Joint& joint = tree_->joints[tree_->dof_joint[spring.dof]];
    for (int i = 0; i < s_; ++i) {
      step.stages().configuration(step.q0(), i, q_);
      spring.slope[i] = -joint.stiffness * so3_right_jacobian_inverse(spring_deflection(*tree_, joint, q_));
    }
  }
}

void ForceAdjoint::take_inputs(SolvedStep& step) {
  const bool acting = step.tau().size() > 0;
  for (std::size_t k = 0; k < inputs_.size(); ++k) {
    const SplitJoint& split = tree_->split[k];
    Input& input = inputs_[k];
    input.tau.setZero();
    if (acting) input.tau.head(input.size) = step.tau().segment(input.dof, input.size);
    for (int i = 0; i < s_; ++i) {
      step.stages().configuration(step.q0(), i, q_);
      if (split.planar) {
        const double c = q_[split.iq + 2], s = q_[split.iq + 3];
        input.axes[i] << c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0;
      } else {
        const int at = split.iq + 3;
        input.axes[i] = Quat(q_[at + 3], q_[at], q_[at + 1], q_[at + 2]).toRotationMatrix();
      }
    }
  }
}

void ForceAdjoint::take_elements(SolvedStep& step) {
  Stages& stages = step.stages();
  for (int i = 0; i < s_; ++i) {
    stages.configuration(step.q0(), i, q_);
    for (int d = 0; d < tree_->nv; ++d) v_[d] = stages.v()[d * S_ + i];
    field_.take(stages.time(i), q_, v_);
    for (int d = 0; d < tree_->nv; ++d)
      for (VecX* direction : {&dq_, &dv_}) {
        (*direction)[d] = 1.0;
        df_.setZero();
        field_.add(dq_, dv_, df_);
        (direction == &dq_ ? slope_q_ : slope_v_)[i].col(d) = df_;
        (*direction)[d] = 0.0;
      }
  }
}

void ForceAdjoint::add(const double* G_bar, double* v_bar, double* q_bar) {
  const int n = tree_->nv;
  if (stiffness_ != nullptr)
    for (int d = 0; d < n; ++d)
      for (int i = d * S_; i < (d + 1) * S_; ++i) {
        v_bar[i] -= damping_[d] * G_bar[i];
        q_bar[i] -= stiffness_[d] * G_bar[i];
      }
  for (const Spring& spring : springs_)
    for (int i = 0; i < s_; ++i) {
      const Vec3 bar = spring.slope[i].transpose() * get(G_bar, spring.dof, i);
      for (int d = 0; d < 3; ++d) add_to(q_bar, spring.dof + d, i, bar[d]);
    }
  // R tau changes by R (turn x tau).
  for (const Input& input : inputs_)
    for (int i = 0; i < s_; ++i) {
      Vec3 bar = get(G_bar, input.dof, i);
      if (input.size == 2) bar[2] = 0.0;
      const Vec3 turn = input.tau.cross(input.axes[i].transpose() * bar);
      if (input.size == 2) {
        add_to(q_bar, input.turn_dof, i, turn[2]);
        continue;
      }
      for (int d = 0; d < 3; ++d) add_to(q_bar, input.turn_dof + d, i, turn[d]);
    }
  for (std::size_t i = 0; i < slope_q_.size(); ++i) {
    for (int d = 0; d < n; ++d) bar_[d] = G_bar[d * S_ + i];
    df_.noalias() = slope_q_[i].transpose() * bar_;
    for (int d = 0; d < n; ++d) add_to(q_bar, d, i, df_[d]);
    df_.noalias() = slope_v_[i].transpose() * bar_;
    for (int d = 0; d < n; ++d) add_to(v_bar, d, i, df_[d]);
  }
}

void ForceAdjoint::inputs(const double* G_bar, VecRef ltau) const {
  for (int d = 0; d < tree_->nv; ++d) {
    ltau[d] = 0.0;
    for (int i = 0; i < s_; ++i) ltau[d] += G_bar[d * S_ + i];
  }
  for (const Input& input : inputs_) {
    Vec3 sum = Vec3::Zero();
    for (int i = 0; i < s_; ++i) {
      Vec3 bar = get(G_bar, input.dof, i);
      if (input.size == 2) bar[2] = 0.0;
      sum += input.axes[i].transpose() * bar;
    }
    ltau.segment(input.dof, input.size) = sum.head(input.size);
  }
}

}  // namespace contactvi

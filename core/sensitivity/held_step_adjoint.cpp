#include "sensitivity/held_step_adjoint.hpp"

namespace contactvi {

HeldStepAdjoint::HeldStepAdjoint(const Scene& scene, int stages)
    : tangent_(scene, stages), adjoint_(scene.tree, stages), lend_(2 * scene.tree.nv) {}

void HeldStepAdjoint::take(const HeldStepRecord& step, const VecX& tau, const Servo* servo) {
  tangent_.take(step, tau, servo);
  adjoint_.take(step.q0, tangent_.p_start_, step.h, tau, step.t, servo, tangent_.velocities_);
  by_q_ = columns(tangent_.nv_, &ContactStepDirection::q);
  by_p_ = columns(tangent_.nv_, &ContactStepDirection::p);
  by_tau_ = columns(tangent_.nv_, &ContactStepDirection::tau);
  by_t_ = columns(&ContactStepDirection::t);
  by_h_ = columns(&ContactStepDirection::h);
}

HeldStepAdjoint::Columns HeldStepAdjoint::columns(int count, VecX ContactStepDirection::* part) {
  HeldStepTangent& t = tangent_;
  Columns found{MatX(t.unknowns(), count), MatX(2 * t.nv_, count)};
  const VecX none = VecX::Zero(t.unknowns());
  ContactStepDirection direction;
  direction.*part = VecX::Zero(count);
  for (int k = 0; k < count; ++k) {
    (direction.*part)[k] = 1.0;
    t.assess(direction, none, found.off.col(k), found.ends.col(k).head(t.nv_), found.ends.col(k).tail(t.nv_));
    (direction.*part)[k] = 0.0;
  }
  return found;
}

HeldStepAdjoint::Columns HeldStepAdjoint::columns(double ContactStepDirection::* part) {
  HeldStepTangent& t = tangent_;
  Columns found{MatX(t.unknowns(), 1), MatX(2 * t.nv_, 1)};
  ContactStepDirection direction;
  direction.*part = 1.0;
  t.assess(direction, VecX::Zero(t.unknowns()), found.off.col(0), found.ends.col(0).head(t.nv_),
           found.ends.col(0).tail(t.nv_));
  return found;
}

// The impulse at the end.
void HeldStepAdjoint::pass_end(const VecX& lq, const VecX& lp, StepParameters& sums) {
  HeldStepTangent& t = tangent_;
  HeldNode& end = t.nodes_.back();
  const HeldStepRecord& s = *t.record_;
  VecX q1(t.tree_->nq), lq_mass(t.nv_), lv(t.nv_);
  integrate(*t.tree_, s.q0, end.displacement(), 1.0, q1);
  const VecX lfaster = t.end_system_.solve_transposed(end.gradients().transpose() * lp);
  const VecX m = t.MinvW_ * lfaster, lp_before = lp + m;
  adjoint_.momentum(q1, s.v1, -m, lq_mass, lv);
  adjoint_.add_momentum_parameters(q1, s.v1, -m, sums);
  lend_.head(t.nv_) =
      lq + lq_mass + end.force_change().transpose() * lp_before + end.speed_change(s.v1).transpose() * lfaster;
  lend_.tail(t.nv_) = lp_before;
  lt_ = lh_ = end.accelerations().dot(lfaster);
}

bool HeldStepAdjoint::solve(const VecX& lq, const VecX& lp, ContactStepGradient& g, StepParameters& sums) {
  constexpr int kPasses = 3;  // the first solves, the others take the rounding off
  const HeldStepTangent& t = tangent_;
  pass_end(lq, lp, sums);
  const VecX by_unknowns = t.ends_.transpose() * lend_;
  VecX mu = t.solve_transposed(by_unknowns);
  for (int pass = 1; pass < kPasses; ++pass) mu += t.solve_transposed(by_unknowns + t.matrix_.transpose() * mu);
  const auto part = [&](const Columns& columns) -> VecX {
    return columns.off.transpose() * mu + columns.ends.transpose() * lend_;
  };
  g.q = part(by_q_);
  g.p = part(by_p_);
  g.tau = part(by_tau_);
  g.t = lt_ + part(by_t_)[0];
  g.h = lh_ + part(by_h_)[0];
  adjoint_.take_multipliers(mu.head(t.stage_unknowns()).reshaped(t.nv_, t.stages_), lend_.head(t.nv_),
                            lend_.tail(t.nv_));
  adjoint_.add_parameters(sums);
  return mu.allFinite() && g.q.allFinite() && g.p.allFinite();
}

}  // namespace contactvi

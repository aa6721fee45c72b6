#include "sensitivity/held_step_adjoint.hpp"

namespace contactvi {

HeldStepAdjoint::HeldStepAdjoint(const Scene& scene, int stages, int contact_points, Kinks& kinks)
    : tangent_(scene, stages, contact_points, kinks), adjoint_(scene.tree, stages) {}

void HeldStepAdjoint::take(const HeldStepRecord& step, const VecX& tau, const Servo* servo) {
  tangent_.take(step, tau, servo);
  adjoint_.take(step.q0, tangent_.p_start_, step.h, tau, step.t, servo, tangent_.velocities_);
  const int n = tangent_.nv_, contacts = static_cast<int>(step.contacts.size());
  ContactStepDirection d;
  by_t_ = columns(1, d, [&](int) -> double& { return d.t; });
  by_h_ = columns(1, d, [&](int) -> double& { return d.h; });
  d.q = VecX::Zero(n);
  by_q_ = columns(n, d, [&](int k) -> double& { return d.q[k]; });
  d.p = VecX::Zero(n);
  by_p_ = columns(n, d, [&](int k) -> double& { return d.p[k]; });
  d.tau = VecX::Zero(n);
  by_tau_ = columns(n, d, [&](int k) -> double& { return d.tau[k]; });
  d.anchors = MatX::Zero(3, contacts);
  by_anchors_ = columns(3 * contacts, d, [&](int k) -> double& { return d.anchors(k % 3, k / 3); });
  d.mu = VecX::Zero(contacts);
  by_mu_ = columns(contacts, d, [&](int k) -> double& { return d.mu[k]; });
  by_start_ = turn_columns();
}

template <class Entry>
HeldStepAdjoint::Columns HeldStepAdjoint::columns(int count, ContactStepDirection& direction, Entry entry) {
  HeldStepTangent& t = tangent_;
  Columns found{MatX(t.unknowns(), count), MatX(t.end_.size(), count)};
  const VecX none = VecX::Zero(t.unknowns()), size = VecX::Zero(t.rows_ + t.numbers());
  for (int k = 0; k < count; ++k) {
    entry(k) = 1.0;
    t.assess(direction, none, t.start_numbers(direction), size, found.off.col(k), found.ends.col(k));
    entry(k) = 0.0;
  }
  return found;
}

HeldStepAdjoint::Columns HeldStepAdjoint::turn_columns() {
  HeldStepTangent& t = tangent_;
  Columns found{MatX(t.unknowns(), t.numbers()), MatX(t.end_.size(), t.numbers())};
  const VecX none = VecX::Zero(t.unknowns()), size = VecX::Zero(t.rows_ + t.numbers());
  const ContactStepDirection nothing;
  for (int j = 0; j < t.numbers(); ++j)
    t.assess(nothing, none, VecX::Unit(t.numbers(), j), size, found.off.col(j), found.ends.col(j));
  return found;
}

bool HeldStepAdjoint::solve(const VecX& lq, const VecX& lp, double lslip, ContactStepGradient& g,
                            StepParameters& sums) {
  constexpr int kPasses = 3;  // the first solves, the others take the rounding off
  HeldStepTangent& t = tangent_;
  VecX lend = VecX::Zero(t.end_.size());
  lend.head(2 * t.nv_) << lq, lp;
  if (t.end_.rests() > 0) lend[2 * t.nv_] = lslip;
  const VecX by_unknowns = t.ends_.transpose() * lend;
  VecX mu = t.solve_transposed(by_unknowns);
  for (int pass = 1; pass < kPasses; ++pass) mu += t.solve_transposed(by_unknowns + t.matrix_.transpose() * mu);
  const auto part = [&](const Columns& columns) -> VecX {
    return columns.off.transpose() * mu + columns.ends.transpose() * lend;
  };
  g.q = part(by_q_);
  g.p = part(by_p_);
  g.tau = part(by_tau_);
  g.anchors = part(by_anchors_).reshaped(3, by_anchors_.off.cols() / 3);
  g.mu = part(by_mu_);
  g.t = part(by_t_)[0];
  g.h = part(by_h_)[0];
  VecX lv = VecX::Zero(t.nv_), lq_before, lp_before, lheavier;
  if (t.slides_ > 0) {
    const VecX lslips = mu.tail(t.turns());
    t.start_.pass(part(by_start_), t.slips_.start_gradient(lslips), adjoint_, sums);
    lv = t.slips_.end_gradient(lslips);
  }
  const HeldNode& end = t.nodes_.back();
  t.end_.pass(lend, lv, lq_before, lp_before, lheavier);
  lq_before += end.force_change().transpose() * lp_before;
  adjoint_.add_momentum_parameters(end.configuration(), t.record_->v1, lheavier, sums);
  adjoint_.take_multipliers(mu.head(t.stage_unknowns()).reshaped(t.nv_, t.stages_), lq_before, lp_before);
  adjoint_.add_parameters(sums);
  return mu.allFinite() && g.q.allFinite() && g.p.allFinite();
}

}  // namespace contactvi

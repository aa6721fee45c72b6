#include "sensitivity/held_start.hpp"

#include <cmath>

namespace contactvi {

namespace {
// Of the terms of a speed: what changes by more along a direction is moved by it.
constexpr double kMoved = 1e-8;
}  // namespace

HeldStart::HeldStart(const Scene& scene) : scene_(&scene), masses_(scene.tree, 1, 1e-12, 1), slip_start_(scene) {}

void HeldStart::take(HeldNode& node, const HeldStepRecord& s, PersistentRows& phase, const VecX& tau,
                     const Servo* servo, StepTangent& momenta) {
  node_ = &node;
  record_ = &s;
  momenta_ = &momenta;
  const Eigen::Index n = scene_->tree.nv, slides = node.along().cols();
  masses_.place_node(s.q0);
  inverse_.setIdentity(n, n);
  masses_.solve_masses(inverse_);
  v0_ = inverse_ * s.p0;
  mass_change_ = momenta.momentum_changes(s.q0, v0_);
  MatX watched;
  node.change_speeds(v0_, watched, along_change_);
  across_change_ = watched.bottomRows(slides);
  across_ = node.watched().rightCols(slides);
  slips_ = node.along().transpose() * v0_;
  guards_.assign(static_cast<std::size_t>(slides), -1);
  for (std::size_t i = 0; i < s.contacts.size(); ++i)
    if (const int j = phase.slide(i); j >= 0) guards_[static_cast<std::size_t>(j)] = s.contacts[i].point.guard;
  std::vector<int> begins;
  const double still = kStillSlip * (1.0 + v0_.cwiseAbs().maxCoeff());
  for (Eigen::Index j = 0; j < slides; ++j)
    if (std::abs(slips_[j]) <= still) begins.push_back(static_cast<int>(j));
  if (slip_start_.take(s, phase, std::move(begins), tau, servo)) return;
  throw NoDerivative({"witness", guards_.front(), s.t}, "The direction in which a slip begins has no derivative",
                     "nearest points inside of their features", "points near their ends", "Start elsewhere");
}

VecX HeldStart::velocity_change(const ContactStepDirection& d) const {
  VecX dp = d.p.size() > 0 ? d.p : VecX(VecX::Zero(v0_.size()));
  if (d.q.size() > 0) dp -= mass_change_ * d.q;
  if (d.parameters != nullptr) {
    VecX heavier = VecX::Zero(v0_.size());
    momenta_->add_momentum(record_->q0, v0_, *d.parameters, heavier);
    dp -= heavier;
  }
  return inverse_ * dp;
}

VecX HeldStart::turns(const ContactStepDirection& d, const VecX& dmu) {
  VecX across = across_.transpose() * velocity_change(d);
  if (d.q.size() > 0) across += across_change_ * d.q;
  VecX found = across.cwiseQuotient(slips_);
  found(slip_start_.begins()).setZero();
  slip_start_.add_turns(d, dmu, found);
  return found;
}

void HeldStart::refuse_moved(int guard) const {
  throw NoDerivative({"friction", guard, record_->t}, "A slip begins at rest, which a direction moves",
                     "a direction that leaves it at rest", "one that does not",
                     "Start in motion; on_kink='taken' gives the derivative of the slip that was taken");
}

void HeldStart::check(const ContactStepDirection& d) {
  const HeldStepRecord& s = *record_;
  const VecX dq = d.q.size() > 0 ? d.q : VecX(VecX::Zero(v0_.size())), dv = velocity_change(d);
  const double still = kStillSlip * (1.0 + v0_.cwiseAbs().maxCoeff());
  const double q = std::max(d.size_q, dq.cwiseAbs().maxCoeff()),
               p = std::max(d.size_p, d.p.size() > 0 ? d.p.cwiseAbs().maxCoeff() : 0.0);
  const VecX size = VecX::Constant(dv.size(), q / s.h) + p * inverse_.cwiseAbs().rowwise().sum();
  const VecX along = node_->along().transpose() * dv + along_change_ * dq;
  const VecX across = across_.transpose() * dv + across_change_ * dq;
  const MatX gradients = node_->along().cwiseAbs() + across_.cwiseAbs();
  const MatX changes = along_change_.cwiseAbs() + across_change_.cwiseAbs();
  const VecX sizes = gradients.transpose() * size + q * changes.rowwise().sum();
  for (const int j : slip_start_.begins()) {
    if (std::hypot(along[j], across[j]) > kMoved * sizes[j]) refuse_moved(guards_[static_cast<std::size_t>(j)]);
  }
  for (const FrictionJoint& joint : s.joints)
    if (!joint.sticks && std::abs(v0_[joint.dof]) <= still && std::abs(dv[joint.dof]) > kMoved * size[joint.dof])
      refuse_moved(-1);
}

void HeldStart::pass(VecX lturns, VecX lv, StepAdjoint& momenta, StepParameters& sums) {
  slip_start_.pass(lturns, sums);
  for (Eigen::Index j = 0; j < slides(); ++j)
    if (lturns[j] != 0.0) lv += (lturns[j] / slips_[j]) * across_.col(j);
  momenta.add_momentum_parameters(record_->q0, v0_, -(inverse_ * lv), sums);
}

}  // namespace contactvi

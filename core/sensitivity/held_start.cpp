#include "sensitivity/held_start.hpp"

#include <cmath>

#include "base/tolerances.hpp"

namespace contactvi {

namespace {
// Of the terms of a speed: what changes by more along a direction is moved by it.
constexpr double kMoved = 1e-8;
}  // namespace

HeldStart::HeldStart(const Scene& scene, Kinks& kinks)
    : scene_(&scene), kinks_(&kinks), masses_(scene.tree, 1, 1e-12, 1), slip_start_(scene) {}

void HeldStart::take(HeldNode& node, const HeldStepRecord& s, PersistentRows& phase, const VecX& tau,
                     const Servo* servo, StepTangent& momenta) {
  node_ = &node;
  record_ = &s;
  momenta_ = &momenta;
  const Eigen::Index n = scene_->tree.nv, slides = node.along().cols(), numbers = node.numbers();
  masses_.place_node(s.q0);
  inverse_.setIdentity(n, n);
  masses_.solve_masses(inverse_);
  v0_ = inverse_ * s.p0;
  mass_change_ = momenta.momentum_changes(s.q0, v0_);
  MatX watched;
  node.change_speeds(v0_, watched, along_change_);
  watched_change_ = watched.bottomRows(numbers);
  watched_ = node.watched().rightCols(numbers);
  by_t_ = node.speed_rates(v0_).tail(numbers);
  slips_ = node.slips(v0_);
  own_.setOnes(numbers);
  own_.head(slides) = -slips_;
  guards_.assign(static_cast<std::size_t>(slides), -1);
  for (std::size_t i = 0; i < s.contacts.size(); ++i)
    if (const int j = phase.slide(i); j >= 0) guards_[static_cast<std::size_t>(j)] = s.contacts[i].point.guard;
  std::vector<int> begins;
  const double still = kStill * (1.0 + v0_.cwiseAbs().maxCoeff());
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
  VecX off = watched_.transpose() * velocity_change(d) + by_t_ * d.t;
  if (d.q.size() > 0) off += watched_change_ * d.q;
  VecX found = -off.cwiseQuotient(own_);
  found(slip_start_.begins()).setZero();
  VecX turns = found.head(slides());
  slip_start_.add_turns(d, found.size() > slides() ? VecX(dmu + found.tail(slides())) : dmu, turns);
  found.head(slides()) = turns;
  return found;
}

void HeldStart::meet_moved(int guard) const {
  kinks_->meet(NoDerivative({"friction", guard, record_->t}, "A slip begins at rest, which a direction moves",
                            "a direction that leaves it at rest", "one that does not",
                            "Start in motion; on_kink='taken' gives the derivative of the slip that was taken"));
}

void HeldStart::check(const ContactStepDirection& d) {
  const HeldStepRecord& s = *record_;
  const VecX dq = d.q.size() > 0 ? d.q : VecX(VecX::Zero(v0_.size())), dv = velocity_change(d);
  const double still = kStill * (1.0 + v0_.cwiseAbs().maxCoeff());
  const double q = std::max(d.size_q, dq.cwiseAbs().maxCoeff()),
               p = std::max(d.size_p, d.p.size() > 0 ? d.p.cwiseAbs().maxCoeff() : 0.0);
  const VecX size = VecX::Constant(dv.size(), q / s.h) + p * inverse_.cwiseAbs().rowwise().sum();
  const Eigen::Index slides = slips_.size();
  const auto across_gradients = watched_.leftCols(slides);
  const auto across_changes = watched_change_.topRows(slides);
  const VecX slip_rates = node_->slip_rates(), across_rates = by_t_.head(slides);
  const VecX along = node_->along().transpose() * dv + along_change_ * dq + slip_rates * d.t;
  const VecX across = across_gradients.transpose() * dv + across_changes * dq + across_rates * d.t;
  const MatX gradients = node_->along().cwiseAbs() + across_gradients.cwiseAbs();
  const MatX changes = along_change_.cwiseAbs() + across_changes.cwiseAbs();
  const VecX sizes = gradients.transpose() * size + q * changes.rowwise().sum() +
                     std::abs(d.t) * (slip_rates.cwiseAbs() + across_rates.cwiseAbs());
  for (const int j : slip_start_.begins()) {
    if (std::hypot(along[j], across[j]) > kMoved * sizes[j]) meet_moved(guards_[static_cast<std::size_t>(j)]);
  }
  for (const FrictionJoint& joint : s.joints)
    if (!joint.sticks && std::abs(v0_[joint.dof]) <= still && std::abs(dv[joint.dof]) > kMoved * size[joint.dof])
      meet_moved(-1);
}

void HeldStart::pass(VecX lnumbers, VecX lv, StepAdjoint& momenta, StepParameters& sums) {
  VecX lturns = lnumbers.head(slides()), lmu = lnumbers.tail(lnumbers.size() - slides());
  slip_start_.pass(lturns, lmu, sums);
  lnumbers << lturns, lmu;
  for (Eigen::Index j = 0; j < lnumbers.size(); ++j)
    if (lnumbers[j] != 0.0) lv -= (lnumbers[j] / own_[j]) * watched_.col(j);
  momenta.add_momentum_parameters(record_->q0, v0_, -(inverse_ * lv), sums);
}

}  // namespace contactvi

#include "sensitivity/held_end.hpp"

#include <cmath>

#include "base/tolerances.hpp"

namespace contactvi {

namespace {
constexpr double kVacuous = 1e-12;  // of the largest mobility: an equation with less says nothing
}  // namespace

HeldEnd::HeldEnd(const Scene& scene) : nv_(scene.tree.nv), masses_(scene.tree, 1, 1e-12, 1) {}

void HeldEnd::take(HeldNode& node, const HeldStepRecord& step, const PersistentRows& phase, int fixed,
                   StepTangent& momenta) {
  node_ = &node;
  record_ = &step;
  fixed_ = fixed;
  const Eigen::Index rows = node.rows(), slides = node.along().cols(), numbers = node.numbers();
  masses_.place_node(node.configuration());
  MinvF_ = node.given();
  MinvC_ = node.watched();
  masses_.solve_masses(MinvF_);
  masses_.solve_masses(MinvC_);
  mass_change_ = momenta.momentum_changes(node.configuration(), step.v1);
  node.change_speeds(step.v1, watched_change_, along_change_);
  MatX A = node.watched().transpose() * MinvF_;
  A.diagonal().segment(rows, slides) -= node.slips(step.v1);
  A.diagonal().tail(numbers - slides).array() += 1.0;
  // What can neither move across its slip nor slips any more has no direction there.
  undirected_.clear();
  const double zero = slides > 0 ? kVacuous * A.diagonal().head(rows).maxCoeff() : 0.0;
  for (Eigen::Index r = rows; r < rows + slides; ++r) {
    if (A.row(r).cwiseAbs().maxCoeff() > zero) continue;
    A.row(r) = VecX::Unit(rows + numbers, r).transpose();
    undirected_.push_back(static_cast<int>(r));
  }
  system_.compute(std::move(A), fixed, static_cast<int>(numbers));
  take_rests(phase);
}

// First what ended the step, then what comes to rest with it.
void HeldEnd::take_rests(const PersistentRows& phase) {
  const HeldStepRecord& s = *record_;
  const auto contacts = static_cast<int>(s.contacts.size()), all = contacts + static_cast<int>(s.joints.size());
  const double still = kStill * (1.0 + s.v1.cwiseAbs().maxCoeff());
  const VecX slips = node_->slips(s.v1), slip_rates = node_->slip_rates();
  std::vector<VecX> speeds, changes;
  std::vector<double> rates;
  const auto add = [&](int number, bool checked) {
    VecX speed = VecX::Zero(nv_), change = speed;
    double left = 0.0, rate = 0.0;
    if (number >= contacts) {
      const FrictionJoint& joint = s.joints[static_cast<std::size_t>(number - contacts)];
      if (joint.sticks) return;
      speed[joint.dof] = joint.heading;
      left = joint.heading * s.v1[joint.dof];
    } else {
      const int j = phase.slide(static_cast<std::size_t>(number));
      if (j < 0) return;
      speed = node_->along().col(j);
      change = along_change_.row(j).transpose();
      left = slips[j];
      rate = slip_rates[j];
    }
    if (checked && !(std::abs(left) <= still)) return;
    rates.push_back(rate);
    speeds.push_back(std::move(speed));
    changes.push_back(std::move(change));
  };
  if (s.ending == HeldStepEnd::kRest) {
    add(s.ended, false);
    for (int number = 0; number < all; ++number)
      if (number != s.ended) add(number, true);
  }
  const auto count = static_cast<Eigen::Index>(speeds.size());
  rest_speeds_.resize(nv_, count);
  rest_changes_.resize(count, nv_);
  rest_rates_ = Eigen::Map<const VecX>(rates.data(), count);
  for (Eigen::Index k = 0; k < count; ++k) {
    rest_speeds_.col(k) = speeds[static_cast<std::size_t>(k)];
    rest_changes_.row(k) = changes[static_cast<std::size_t>(k)].transpose();
  }
  MinvR_ = rest_speeds_;
  if (count > 0) masses_.solve_masses(MinvR_);
}

bool HeldEnd::add_impulse(const VecX& heavier, double later, const VecX& sizes, VecRef end, VecX& dv) {
  const VecX dq = end.head(nv_), all_heavier = heavier + mass_change_ * dq;
  VecX dp = end.segment(nv_, nv_), impulses;
  VecX faster = watched_change_ * dq + MinvC_.transpose() * (dp - all_heavier);
  faster += node_->speed_rates(record_->v1) * later;
  faster(undirected_).setZero();
  const bool agree = system_.solve(faster, sizes, impulses);
  dp += node_->given() * impulses;
  end.segment(nv_, nv_) = dp;
  if (node_->along().cols() == 0 && rests() == 0) return agree;
  dv = dp - all_heavier;
  masses_.solve_mass(dv);
  end.tail(rests()) = rest_speeds_.transpose() * dv + rest_changes_ * dq + rest_rates_ * later;
  return agree;
}

void HeldEnd::pass(const VecX& lend, VecX lv, VecX& lq, VecX& lp, VecX& lheavier) {
  const VecX lslips = lend.tail(rests());
  lv += rest_speeds_ * lslips;
  masses_.solve_mass(lv);
  lp = lend.segment(nv_, nv_);
  VecX lfaster = system_.solve_transposed(node_->given().transpose() * (lp + lv));
  lfaster(undirected_).setZero();
  lheavier = -lv - MinvC_ * lfaster;
  lp -= lheavier;
  lq = lend.head(nv_) + rest_changes_.transpose() * lslips + mass_change_.transpose() * lheavier +
       watched_change_.transpose() * lfaster;
}

PhaseEnd HeldEnd::phase_end(const PersistentRows& phase, int number) {
  const HeldStepRecord& s = *record_;
  const VecX& q1 = node_->configuration();
  VecX p1(nv_), force(nv_);
  masses_.dynamics(q1, s.v1, p1, force);
  PhaseEnd end{s.t + s.h, q1, p1, s.v1, fixed_, {}, {}, s.ended, s.ending == HeldStepEnd::kRelease};
  for (const FrictionJoint& joint : s.joints) end.joints.push_back({joint.dof, joint.limit});
  end.rows += static_cast<int>(s.joints.size());
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const PersistentRows::Site& site = phase.site(number, i);
    end.contacts.push_back({s.contacts[i], site.frame.t1, site.contact.normal, s.contacts[i].slides(), end.rows});
    end.rows += s.contacts[i].rows();
  }
  masses_.place_node(q1);
  return end;
}

}  // namespace contactvi

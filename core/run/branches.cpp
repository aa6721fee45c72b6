#include "run/branches.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {

// Changes of one law at one instant after which its branch is held: from one branch to the other and back again, each
// of which ends at once, the motion stays between the two.
constexpr int kAtOneInstant = 2;
// Changes in a control step after which all branches are held. Ropes and actuators have inertia to move between two
// changes; no run has been seen with more than some ten in a step that resolves its motion.
constexpr long kMostChanges = 1000;

}  // namespace

Branches::Branches(const Tree& tree, Actuation& actuation, Integrator& integrator)
    : tree_(&tree), actuation_(&actuation), integrator_(&integrator), pulls_(tree.elements.path_springs.size(), 0) {
  for (std::size_t k = 0; k < tree.elements.path_springs.size(); ++k) {
    const PathSpring& spring = tree.elements.path_springs[k];
    if (!spring.tension_only || (spring.stiffness == 0.0 && spring.damping == 0.0)) continue;
    ropes_.push_back(static_cast<int>(k));
    Law law;
    law.rope = static_cast<int>(k);
    laws_.push_back(law);
  }
  for (const int d : actuation.limited_dofs()) {
    Law law;
    law.dof = d;
    laws_.push_back(law);
  }
}

void Branches::begin_interval() {
  changes_ = 0;
  for (Law& law : laws_) {
    law.held = false;
    law.without_motion = 0;
  }
}

void Branches::begin_step(const VecX& q0, const VecX& v0, bool keep) {
  q0_ = q0;
  if (!ropes_.empty()) {
    if (!keep) {
      integrator_->field().slackness(ropes_, q0, v0, slackness_);
      for (std::size_t i = 0; i < ropes_.size(); ++i)
        pulls_[static_cast<std::size_t>(ropes_[i])] = slackness_[i].value > 0.0;
    }
    integrator_->field().hold_branches(&pulls_);
  }
  active_.clear();
  for (std::size_t k = 0; k < laws_.size(); ++k) {
    const Law& law = laws_[k];
    if (law.held) continue;
    // What is asked of a joint without a servo stays what it is; an actuator without effort does nothing.
    const bool drives = law.dof >= 0 && actuation_->effort_limit(law.dof) > 0.0 &&
                        (actuation_->is_driven(law.dof) || std::isfinite(actuation_->speed_limit(law.dof)));
    if (law.rope >= 0 || drives) active_.push_back(static_cast<int>(k));
  }
}

void Branches::evaluate(double at, const VecX& q, const VecX& v, VecRef values) {
  if (!ropes_.empty()) integrator_->field().slackness(ropes_, q, v, slackness_);
  std::size_t rope = 0;
  for (std::size_t i = 0; i < active_.size(); ++i) {
    const Law& law = laws_[static_cast<std::size_t>(active_[i])];
    double& value = values[static_cast<Eigen::Index>(i)];
    if (law.rope < 0) {
      Drive next;
      value = drive_value(law.dof, t0_ + at * h_, q, v, next);
      continue;
    }
    while (ropes_[rope] != law.rope) ++rope;
    value = slackness_[rope].size > 0.0 ? slackness_[rope].value / slackness_[rope].size : 0.0;
    if (pulls_[static_cast<std::size_t>(law.rope)] == 0) value = -value;
  }
}

// The least of the distances from where the actuator's branch ends, relative to their terms, and the branch beyond.
double Branches::drive_value(int d, double t, const VecX& q, const VecX& v, Drive& next) const {
  const Drive now = actuation_->drive(d);
  const Actuation::Asked asked = actuation_->asked(d, q0_, t, q, v);
  const double most = actuation_->effort_limit(d), fastest = actuation_->speed_limit(d), speed = std::abs(v[d]);
  const bool limited = std::isfinite(most);
  const double size = asked.size + (limited ? most : 0.0), unit = size > 0.0 ? size : 1.0;
  double least = INFINITY;
  const auto keep = [&](double value, Drive beyond) {
    if (!(value < least)) return;
    least = value;
    next = beyond;
  };
  const Drive clamped = asked.effort > most ? Drive::kHigh : asked.effort < -most ? Drive::kLow : Drive::kAsked;
  next = now;
  if (limited && now == Drive::kAsked) {
    keep((most - asked.effort) / unit, Drive::kHigh);
    keep((most + asked.effort) / unit, Drive::kLow);
  }
  if (now == Drive::kHigh) keep((asked.effort - most) / unit, Drive::kAsked);
  if (now == Drive::kLow) keep((-most - asked.effort) / unit, Drive::kAsked);
  if (!std::isfinite(fastest)) return least;
  // The joint is driven on where this is positive.
  const double onward = std::copysign(asked.effort, asked.effort * v[d]) / unit;
  const double slower = (fastest - speed) / (fastest + speed);
  if (now == Drive::kCut) {
    keep(-slower, clamped);
    keep(onward, clamped);
  } else {
    // Below half the speed the direction does not matter, so that the function has no jump where the joint turns back.
    const double share = fastest > 0.0 ? std::clamp(2.0 * speed / fastest - 1.0, 0.0, 1.0) : 1.0;
    keep(std::max(slower, -share * onward), Drive::kCut);
  }
  return least;
}

bool Branches::change(int function, double t, const VecX& q, const VecX& v, bool moved) {
  Law& law = laws_[static_cast<std::size_t>(active_[static_cast<std::size_t>(function)])];
  if (moved)
    for (Law& other : laws_) other.without_motion = 0;
  law.without_motion += moved ? 0 : 1;
  ++changes_;
  switched_ = law.without_motion <= 1;  // several laws may change at one instant
  if (law.rope >= 0) {
    char& pulls = pulls_[static_cast<std::size_t>(law.rope)];
    pulls = pulls == 0 ? 1 : 0;
    // On the way back its pull comes to zero and grows from zero; on the way out its damper acts at once.
    jumped_ = tree_->elements.path_springs[static_cast<std::size_t>(law.rope)].damping > 0.0 && pulls != 0;
  } else {
    Drive next;
    drive_value(law.dof, t, q, v, next);
    jumped_ = next == Drive::kCut || actuation_->drive(law.dof) == Drive::kCut;
    actuation_->enter(law.dof, next);
  }
  if (changes_ > kMostChanges)
    for (Law& other : laws_) other.held = true;
  if (law.without_motion >= kAtOneInstant) law.held = true;
  return !law.held;
}

}  // namespace contactvi

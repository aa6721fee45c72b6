#include "run/branches.hpp"

#include <algorithm>
#include <cmath>

#include "model/compliance.hpp"
#include "run/step_control.hpp"

namespace contactvi {

namespace {

// Changes of one law at one instant after which its branch is held: from one branch to the other and back again, each
// of which ends at once, the motion stays between the two.
constexpr int kAtOneInstant = 2;
// Changes in a control step after which all branches are held. Ropes and actuators have inertia to move between two
// changes; no run has been seen with more than some ten in a step that resolves its motion.
constexpr long kMostChanges = 1000;
constexpr double kLeastRatio = 1e-16;
// The force of a contact that opens or closes grows like t^n with the time t from there. A step of s stages from t on
// of length h leaves out some h^(2 s + 1) t^(n - 2 s), so that steps of the length h (t / T)^p with
// p = (2 s - n) / (2 s + 1) all leave out as much as those in the middle of the contact, whose duration is about 2 T.
double graded(double h, double t, double T, double n, int stages) {
  const double s2 = 2.0 * stages, p = (s2 - n) / (s2 + 1.0);
  if (!(h < T) || !(p > 0.0)) return h;
  // The first step begins at t = 0: it is as long as what lies before it. What it leaves out of the motion, some
  // (first / T)^(n + 1), is no less than rounding.
  const double first = T * std::max(std::pow(h / T, 1.0 / (1.0 - p)), std::pow(kLeastRatio, 1.0 / (n + 1.0)));
  return t < first ? first : std::min(h, h * std::pow(t / T, p));
}

// Of a force of the user, the depth at which it is asked how stiff it is where it begins [m].
constexpr double kShallow = 1e-9;

double stiffness_at(const ComplianceLaw& law, double depth) {
  if (!law.force) return law.stiffness;
  const double d = std::max(depth, kShallow);
  return (*law.force)(d, 0.0).value / std::pow(d, law.exponent);
}

}  // namespace

Branches::Branches(const Tree& tree, Actuation& actuation, Integrator& integrator)
    : tree_(&tree),
      actuation_(&actuation),
      integrator_(&integrator),
      pulls_(tree.elements.path_springs.size() + tree.elements.compliances.size(), 0),
      row_(tree.nv),
      answer_(tree.nv) {
  for (std::size_t k = 0; k < tree.elements.path_springs.size(); ++k) {
    const PathSpring& spring = tree.elements.path_springs[k];
    if (!spring.tension_only || (spring.stiffness == 0.0 && spring.damping == 0.0)) continue;
    ropes_.push_back(static_cast<int>(k));
    Law law;
    law.rope = static_cast<int>(k);
    laws_.push_back(law);
  }
  for (std::size_t k = 0; k < tree.elements.compliances.size(); ++k) {
    const ComplianceLaw& compliance = tree.elements.compliances[k].law;
    if (compliance.stiffness == 0.0 && !compliance.force) continue;
    Law law;
    law.rope = static_cast<int>(tree.elements.path_springs.size() + k);
    ropes_.push_back(law.rope);
    laws_.push_back(law);
    if (compliance.exponent != std::floor(compliance.exponent)) broken_.push_back(law.rope);
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

bool Branches::presses_nonlinearly() const {
  const auto& contacts = tree_->elements.compliances;
  for (std::size_t k = 0; k < contacts.size(); ++k) {
    const ComplianceLaw& law = contacts[k].law;
    const bool linear = law.exponent == 1.0 && law.damping == 0.0 && !law.force;
    if (!linear && pulls_[tree_->elements.path_springs.size() + k] != 0) return true;
  }
  return false;
}

// Of a contact with the speed w, the mass m along its normal and the depth d, E = m w^2/2 + k d^(n+1)/(n+1) tells how
// deep and how fast it comes, D and W, and so its time T = D / W; from its opening it is t = d / |w|.
double Branches::limit(double h, double nominal, const VecX& q, const VecX& v) {
  double longest = nominal;
  bool placed = false;
  for (const int k : broken_) {
    if (pulls_[static_cast<std::size_t>(k)] == 0) continue;
    const ComplianceLaw& law =
        tree_->elements.compliances[static_cast<std::size_t>(k) - tree_->elements.path_springs.size()].law;
    const double depth = std::max(0.0, integrator_->field().depth(k, q, row_)), speed = std::abs(row_.dot(v));
    answer_ = row_;
    if (!placed) integrator_->place_node(q);
    placed = true;
    integrator_->solve_mass(answer_);
    const double mass = 1.0 / row_.dot(answer_), n = law.exponent, stiffness = stiffness_at(law, depth);
    const double energy = 0.5 * mass * speed * speed + stiffness * std::pow(depth, n + 1.0) / (n + 1.0);
    const double deepest = std::pow(energy * (n + 1.0) / stiffness, 1.0 / (n + 1.0));
    const double T = deepest / std::sqrt(2.0 * energy / mass);
    if (!std::isfinite(T)) continue;
    const double t = speed > 0.0 ? depth / speed : T;
    longest = std::min(longest, graded(nominal, t, T, n, integrator_->stages()));
  }
  return longest < h ? step_length_within(longest, nominal) : h;
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
    const auto k = static_cast<std::size_t>(law.rope);
    const bool is_spring = k < tree_->elements.path_springs.size();  // the force of a contact grows from zero as well
    jumped_ = is_spring ? tree_->elements.path_springs[k].damping > 0.0 && pulls != 0
                        : integrator_->field().jumps(law.rope, q, v);
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

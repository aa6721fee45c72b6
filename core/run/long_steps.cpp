#include "run/long_steps.hpp"

#include <algorithm>
#include <cmath>

#include "model/compliance.hpp"

namespace contactvi {

namespace {

// Turn of a body against the world in a step from which on its energy is looked at [rad]. The midpoint rule's equation
// of a pendulum, X/2 = h v/2 - (h^2 w^2/4) sin(q + X/2), has one solution for every start as long as h w < 2, and
// its energy is off by (h w)^2/12 of the kinetic energy; a body that turns by less than this in a step has h w below
// it, or little energy.
constexpr double kTurn = 0.4;
// Share of the highest mode in the motion of the stages below which several stages resolve it.
constexpr double kResolvedEnergy = 0.02;
// Of the scale of the motion's energy: a run stays within this of its energy, or steps that lead out of it are halved.
// A step of a resolved motion stays below a tenth of this.
constexpr double kBudget = 0.05;

// Of the energies in a step that a nonlinear compliant contact may change, or the step is halved. One that resolves the
// contact by ten steps stays far below.
constexpr double kContactEnergy = 0.01;
constexpr double kBoundRounding = 1e-12;

bool turns(const Joint& joint) { return joint.type != JointType::kPrismatic && joint.type != JointType::kTranslation; }

// Of all compliant contacts [J].
double elastic_energy(const Tree& tree, const VecX& q) {
  Placements at(tree);
  place(tree, q, at);
  double sum = 0.0;
  for (const CompliantContact& c : tree.elements.compliances) sum += compliance_scale(c.law, touch_of(c, at).gap);
  return sum;
}

}  // namespace

LongSteps::LongSteps(const Tree& tree) : tree_(&tree), turn_(tree.joints.size()) {
  std::vector<int> depth(tree.joints.size());
  for (std::size_t i = 0; i < tree.joints.size(); ++i) {
    const Joint& joint = tree.joints[i];
    depth[i] = (joint.parent >= 0 ? depth[static_cast<std::size_t>(joint.parent)] : 0);
    if (turns(joint)) depth[i] += joint.type == JointType::kSpherical ? 2 : 1;  // the norm of three numbers
    depth_ = std::max(depth_, depth[i]);
  }
}

bool LongSteps::may_be_long(const double* velocities, int stages, double h) const {
  double largest = 0.0;
  const int count = tree_->nv * stages;
  for (int i = 0; i < count; ++i) largest = std::max(largest, std::abs(velocities[i]));
  return depth_ * h * largest > kTurn;
}

bool LongSteps::is_long(StepEquations& equations, double h) {
  const MatX& v = equations.velocities();
  const int s = equations.stages();
  double most = 0.0;
  for (std::size_t i = 0; i < turn_.size(); ++i) {
    const Joint& joint = tree_->joints[i];
    double own = 0.0;
    if (turns(joint))
      for (int k = 0; k < s; ++k) own += v.col(k).segment(joint.iv, joint.nv).norm() / s;
    turn_[i] = h * own + (joint.parent >= 0 ? turn_[static_cast<std::size_t>(joint.parent)] : 0.0);
    most = std::max(most, turn_[i]);
  }
  if (!(most > kTurn)) return false;
  return s == 1 || equations.truncation() > kResolvedEnergy * equations.stage_motion();
}

bool keeps_energy(EnergyWatch& watch, const StepEnergy& energy) {
  const auto& [before, after, kinetic, rise] = energy;
  if (!watch.known) {
    watch.known = true;
    watch.start = before;
    watch.scale = 0.0;
  }
  const double scale = std::max({watch.scale, kinetic, std::abs(rise)});
  const double off = std::abs(after - watch.start), was = std::abs(before - watch.start);
  if (!(off <= kBudget * scale || off <= was)) return false;
  watch.scale = std::max(watch.scale, kinetic);
  return true;
}

bool contacts_keep_energy(const Tree& tree, const StepEnergy& energy, const VecX& q0, const VecX& q1) {
  const double elastic = elastic_energy(tree, q0) + elastic_energy(tree, q1);
  const double scale = std::max({energy.kinetic, std::abs(energy.rise), elastic});
  return std::abs(energy.after - energy.before) <= kContactEnergy * scale + kBoundRounding * std::abs(energy.before);
}

}  // namespace contactvi

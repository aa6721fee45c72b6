// ContactStep: its work, and by how much it may be wrong about the energy.
#include <algorithm>
#include <cmath>

#include "contact/contact_step.hpp"
#include "model/forces.hpp"
#include "step/energy.hpp"

namespace contactvi {

namespace {
constexpr double kErrorShare = 1.0 / 12.0;  // of the squares of angles and changes of velocity, see energy_error
constexpr double kGauss =
    10.0;  // of the accelerations without contacts: those with them are hardly more, see energy_error
constexpr double kGapError = 1e-9;  // [m] of an overlap that a nominal step may move bodies out of
}  // namespace

double ContactStep::joint_friction_loss() const {
  double total = 0.0;
  for (int k = 0; k < friction_rows_; ++k)
    total -= (lambda_[bilateral_ + k] + lambda_end_[bilateral_ + k]) * v_[friction_joints_[k].dof];
  return total;
}

double ContactStep::friction_work() const {
  double total = 0.0;
  for (const ContactOutcome& out : outcomes_) total += out.friction_work;
  return total;
}

// Forces on what moves by itself, a prescribed constraint or the surface of a belt, have power: the velocities that the
// bodies have along these rows are -rate, beside the slip on a surface.
double ContactStep::driven_work() const {
  if (bilateral_ == 0 && scene_->surface_motions.empty()) return 0.0;
  return -lambda_.dot(node0_.rate) - lambda_end_.dot(node1_.rate);
}

double ContactStep::mean_work() const {
  double impulses = 0.0;
  if (bilateral_ > 0 || !scene_->surface_motions.empty()) impulses -= lambda_.dot(node0_.rate);
  for (int k = 0; k < friction_rows_; ++k) impulses += lambda_[bilateral_ + k] * v_[friction_joints_[k].dof];
  return integrator_.mean_work() + impulses;
}

double ContactStep::discrete_energy() {
  const Tree& tree = scene_->tree;
  VecX middle(tree.nq), P(tree.nv), force(tree.nv);
  integrate(tree, node0_.q, v_, 0.5 * h_, middle);
  integrator_.dynamics(middle, v_, P, force);
  Placements at(tree);
  place(tree, middle, at);
  return 0.5 * P.dot(v_) + total_potential(tree, integrator_.field(), at, middle);
}

double ContactStep::modified_hamiltonian(double t, const VecCRef& q, const VecCRef& p, double h) {
  return contactvi::modified_hamiltonian(integrator_, q, p, h, t);
}

// The energy that a midpoint step conserves differs from H by h^2 (a.M a and T omega^2) / 12 or less, and what it
// differs by changes in the step. Forces of contacts and constraints that persist change the accelerations by no more
// than those without them and the turning of the bodies ask for (Gauss's principle of least constraint): impulses that
// are those of an impact excuse no gain. Persistent contacts do no work but where they move bodies out of an overlap.
// Driven constraints move by the mean of their speeds at both nodes, the trapezoid of which driven_work() is the work,
// and the bodies by the step: where these differ so does what their forces do.
double ContactStep::energy_error(const VecCRef& p0, const VecCRef& p1) {
  const double turn = largest_turn(scene_->tree, v_, h_);
  const double kinetic = 0.5 * std::max(p0.dot(v_start_), p1.dot(v1_));
  double mass = 0.0, impulses = 0.0;
  for (const Joint& joint : scene_->tree.joints) mass += joint.mass;
  for (const ContactOutcome& out : outcomes_) impulses += out.position_impulse.norm() + out.velocity_impulse.norm();
  double trapezoid = 0.0;
  if (bilateral_ > 0) {
    const VecX mean = 0.5 * ((node0_.W + node1_.W).leftCols(bilateral_).transpose() * v_ +
                             (node0_.rate + node1_.rate).head(bilateral_));
    trapezoid = std::abs((lambda_ + lambda_end_).head(bilateral_).dot(mean));
  }
  const double turned = turn * turn * kinetic, free = kGauss * (free_change(p0, p1) + turned);
  return trapezoid + kErrorShare * (turned + std::min(free, std::abs((p1 - p0).dot(v1_ - v_start_)))) +
         kGapError * (mass * scene_->tree.gravity.norm() + impulses / std::max(h_, nominal_h_));
}

}  // namespace contactvi

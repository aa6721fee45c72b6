// ContactStep: the continuous contact forces at a node, which tell when a contact separates.
//
// Accelerations instead of impulses: a_n = d/dt (W_n v) along the motion with the forces f on it,
//   0 <= f_n _|_ a_n >= 0,  sticking: Coulomb's law between f_t and a_t, slipping: f_t = -mu f_n d.
// d/dt (W v) without contact forces is W a and the difference of W v at q (+) +-delta v, with a the acceleration and v
// as it is: what a moves the rows by counts for nothing, and may be large where light bodies are held.
#include <algorithm>
#include <cmath>

#include "base/tolerances.hpp"
#include "contact/contact_step.hpp"
#include "contact/delassus.hpp"
#include "step/energy.hpp"

namespace contactvi {

namespace {
constexpr double kSide = 1e-5;     // [m; rad] displacement of the finite difference at most,
constexpr double kLongest = 1e-3;  // [s] and its time at most
constexpr double kNoise = 1e-9;    // of the largest acceleration: error of the finite differences,
constexpr double kAgree = 1e-7;    // and residual that they leave where contacts share their load
constexpr double kFalling = 0.35;  // of the larger force: one extrapolated to less may reach zero soon

// Friction against spinning and rolling goes on in the direction that it has.
void freeze_turning(const ContactOutcome& out, ConeContact& cone) {
  const Vec3 slip(out.slip_W.dot(out.t1), out.slip_W.dot(out.t2), cone.spins ? out.spin : 0.0), d = slip.normalized();
  cone.frozen = out.slips;
  cone.d = d.head<2>();
  cone.d_spin = d[2];
  cone.frozen_rolling = out.rolls;
  cone.d_rolling = Eigen::Vector2d(out.roll_W.dot(out.t1), out.roll_W.dot(out.t2)).normalized();
}

}  // namespace

// What the force does within a step shows in its two impulses where the geometry changes it: to leading order they are
// then the forces at one third and two thirds of the step. What springs and inputs change is evaluated at the midpoint
// alone, and shows in the mean forces of this step and of the one before; of the first step of a contact it is not
// known.
bool ContactStep::may_release() const {
  const auto falls = [](double first, double second) {
    return 2.0 * second - first < kFalling * std::max(first, second) || !(first > 0.0);
  };
  for (std::size_t i = 0; i < outcomes_.size(); ++i) {
    const double first = outcomes_[i].position_impulse[0], second = outcomes_[i].velocity_impulse[0];
    if (falls(first, second) || falls(contacts_[i].force[0], (first + second) / h_)) return true;
  }
  return false;
}

// b_ = d/dt (W v) of all rows without contact forces. node1_ is at q, and the equations hold the mass matrix there.
bool ContactStep::accelerations(StepEquations& equations, const VecCRef& q, const VecCRef& v, const VecX& tau) {
  forward_dynamics(equations, q, v, node1_.t, tau, acceleration_);
  if (!acceleration_.allFinite()) return false;
  const double speed = v.cwiseAbs().maxCoeff(), delta = std::min(kLongest, kSide / (speed + kSide));
  b_.noalias() = node1_.W.transpose() * acceleration_;
  const std::vector<Constraint>& constraints = scene_->tree.elements.constraints;
  node1_.motions.ask(constraints, node1_.t);
  const Node kept0 = node0_, kept1 = node1_;
  for (const double side : {1.0, -1.0}) {
    integrate(scene_->tree, q, v, side * delta, q_side_);
    node0_ = kept1;
    end_node(q_side_, kept1.t + side * delta, kept1.motions.later(constraints, side * delta));
    b_.noalias() += (0.5 * side / delta) * (node1_.W.transpose() * v);
    b_ += (0.5 * side / delta) * node1_.rate;
  }
  node0_ = kept0;
  node1_ = kept1;
  for (std::size_t i = 0; i < contacts_.size() && adheres_; ++i)
    b_ -= adhesion(*scene_, contacts_[i], node1_.t) * G_end_.col(row_[i]);
  return b_.allFinite();
}

// The rows at node0_, where the equations hold the mass matrix, and their velocities.
void ContactStep::set_force_rows(StepEquations& equations, const VecCRef& v) {
  node1_ = node0_;
  MinvW_ = node1_.W;
  equations.solve_masses(MinvW_);
  delassus(node1_.W, MinvW_, G_end_);
  w_end_.noalias() = node1_.W.transpose() * v;
  w_end_ += node1_.rate;
}

// The forces in force_cones_ for the accelerations b_ without them, from start values.
bool ContactStep::solve_forces(VecX& f) {
  if (bilateral_ > 0) reduction_.set(G_end_, bilateral_, friction_rows_);
  FrictionRounds rounds;
  do {
    if (!solve_rows(force_cones_, G_end_, b_, kNoise * b_.cwiseAbs().maxCoeff(), f, true, {0.0, kAgree})) return false;
  } while (follows_forces_ && rounds.go_on(follow_forces(f, 1.0, force_cones_)));
  if (!rounds.settled()) return false;
  double stiffest = 0.0;
  for (std::size_t i = 0; i < contacts_.size(); ++i) stiffest = std::max(stiffest, G_end_(row_[i], row_[i]));
  force_scale_ = stiffest > 0.0 ? std::max(scene_->tree.gravity.norm() / stiffest, f.cwiseAbs().maxCoeff()) : 0.0;
  return true;
}

// The friction of the contacts at the present speeds of the rows, with the forces that are known so far.
void ContactStep::set_force_coefficients() {
  friction_states_.clear();
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    const ConeContact& cone = force_cones_[friction_rows_ + i];
    const bool varies = scene_->friction_varies(contacts_[i].point.guard);
    const double slip = varies && cone.frozen ? force_frame(i).slip(force_slip(i)).norm() : 0.0;
    friction_states_.push_back(
        {contacts_[i].point.guard, !cone.frozen, slip, contacts_[i].force[0], node1_.t, cone.mu});
  }
  set_friction(*scene_, friction_states_);
  for (std::size_t i = 0; i < contacts_.size(); ++i) force_cones_[friction_rows_ + i].mu = friction_states_[i].mu;
}

// By how much of themselves coefficients of friction change with the forces that were found with them: what acts in the
// rows for this time, in the cones of joints and contacts.
double ContactStep::follow_forces(const VecX& impulses, double time, std::vector<ConeContact>& cones) {
  for (std::size_t i = 0; i < contacts_.size(); ++i) friction_states_[i].normal = impulses[row_[i]] / time;
  set_friction(*scene_, friction_states_);
  double change = 0.0;
  for (std::size_t i = 0; i < contacts_.size(); ++i)
    change = FrictionRounds::larger(change, friction_states_[i].mu, cones[friction_rows_ + i].mu);
  return change;
}

bool ContactStep::force_problem(VecX& value) {
  const double still = kStill * (1.0 + v1_.cwiseAbs().maxCoeff());
  for (int k = 0; k < friction_rows_; ++k) {
    ConeContact& cone = force_cones_[k] = joint_friction_cone(k, friction_joints_[k].limit);
    const double v = v1_[friction_joints_[k].dof];
    cone.frozen = std::abs(v) > still;
    cone.d[0] = v > 0.0 ? 1.0 : -1.0;
  }
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    ConeContact& cone = force_cones_[friction_rows_ + i];
    cone = cones_[friction_rows_ + i];
    if (cone.rows > 3) {
      freeze_turning(outcomes_[i], cone);
      continue;
    }
    cone.frozen = cone.rows == 3 && outcomes_[i].slips;
    if (!cone.frozen) continue;
    const ContactOutcome& out = outcomes_[i];
    cone.d = frame(i, node1_).rows(out.slip_W).normalized();
  }
  if (friction_varies_) set_force_coefficients();
  change_.setZero(rows_);
  if (h_ > 0.0) {
    change_ = (2.0 / h_) * lambda_end_;
    if (shift_.size() == rows_) change_ += 2.0 * shift_;  // none is known after leave()
  }
  if (!solve_forces(change_)) return false;
  b_.noalias() += G_end_ * change_;
  value.resize(static_cast<Eigen::Index>(contacts_.size()));
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    const int r = row_[i];
    value[static_cast<Eigen::Index>(i)] = change_[r] - (change_[r] > 0.0 ? 0.0 : b_[r] / G_end_(r, r));
  }
  return value.allFinite();
}

bool ContactStep::persistent_forces(const VecX& tau, VecX& value) {
  shows_part_ = false;
  force_cones_.resize(friction_rows_ + contacts_.size());
  return accelerations(integrator_, q1_, v1_, tau) && force_problem(value);
}

bool ContactStep::persistent_forces_at(const VecCRef& q, const VecCRef& p, const VecX& tau, VecX& value) {
  shows_part_ = false;
  start_node(q);
  force_cones_.resize(friction_rows_ + contacts_.size());
  q1_ = q;
  p1_ = p;
  if (!integrator_.node_velocity(q, p, v1_)) return false;
  set_force_rows(integrator_, v1_);
  lambda_.setZero();
  lambda_end_.setZero();
  h_ = 0.0;
  for (ContactOutcome& out : outcomes_) out.slipped = false;
  set_outcomes();
  return accelerations(integrator_, q1_, v1_, tau) && force_problem(value);
}

bool ContactStep::forces_at(StepEquations& equations, const VecCRef& q, const VecCRef& v, double t, const VecX& tau,
                            const std::vector<Vec3>& directions, Forces& out) {
  leave();
  integrator_.set_time(t);
  start_node(q);
  equations.place_node(q);
  set_force_rows(equations, v);
  if (!accelerations(equations, q, v, tau)) return false;
  const double still = kStill * (1.0 + v.cwiseAbs().maxCoeff());
  force_cones_.resize(friction_rows_ + contacts_.size());
  for (int k = 0; k < friction_rows_; ++k) {
    const FrictionJoint& joint = friction_joints_[k];
    ConeContact& cone = force_cones_[k] = joint_friction_cone(k, joint.limit);
    cone.frozen = !joint.sticks;
    cone.d[0] = joint.heading > 0.0 ? 1.0 : -1.0;
  }
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    ConeContact& cone = force_cones_[friction_rows_ + i];
    cone = cones_[friction_rows_ + i];
    cone.frozen = cone.rows == 3 && !contacts_[i].sticks;
    if (!cone.frozen) continue;
    const Eigen::Vector2d known = force_frame(i).rows(directions[i]);
    const Eigen::Vector2d slip = w_end_.segment<2>(row_[i] + 1);
    cone.d = slip.norm() > still ? Eigen::Vector2d((slip.dot(known) < 0.0 ? -slip : slip).normalized())
                                 : Eigen::Vector2d(known.normalized());
  }
  if (friction_varies_) set_force_coefficients();
  out.f.setZero(rows_);
  for (std::size_t i = 0; i < contacts_.size(); ++i)
    out.f.segment(row_[i], contacts_[i].rows()) = contacts_[i].force.head(contacts_[i].rows());
  out.largest = b_.cwiseAbs().maxCoeff();
  if (!solve_forces(out.f)) return false;
  out.a = b_ + G_end_ * out.f;
  out.scale = std::max(force_scale_, out.f.cwiseAbs().maxCoeff());
  for (const FrictionJoint& joint : friction_joints_) out.scale = std::max(out.scale, joint.limit);
  return out.f.allFinite() && out.a.allFinite() && out.scale > 0.0;
}

}  // namespace contactvi

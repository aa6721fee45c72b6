// ContactStep: the rows of constraints and of joint friction.
#include <algorithm>
#include <cmath>
#include <limits>

#include "base/tolerances.hpp"
#include "contact/contact_step.hpp"
#include "model/constraint_check.hpp"
#include "model/constraints.hpp"

namespace contactvi {

// The rows of constraints and joint friction at q; the guards are placed there.
// motions: those of the time t that are known.
void ContactStep::constraint_node(const VecCRef& q, double t, Node& node, const MotionValues& motions) {
  node.t = t;
  node.motions = motions;
  if (bilateral_ > 0)
    evaluate_constraints(scene_->tree, guards_->placements(), q, t, node.phi, node.W.leftCols(bilateral_),
                         node.rate.head(bilateral_), node.motions);
  if (friction_rows_ > 0) node.W.middleCols(bilateral_, friction_rows_).setZero();
  for (int k = 0; k < friction_rows_; ++k) node.W(friction_joints_[k].dof, bilateral_ + k) = 1.0;
}

// Whether the slip of a joint with friction in a step of length h is a displacement, not a speed.
bool ContactStep::counts_by_place(const FrictionJoint& joint, double h) const {
  return joint.iq >= 0 && h >= ContactStepRecord::kShortestDifference * nominal_h_;
}

// The velocities y_ of the rows of constraints and joint friction over the step, and their derivatives S_. The error of
// a constraint at the start is corrected over a nominal step.
void ContactStep::set_constraint_velocities(double h) {
  if (bilateral_ > 0) {
    auto S = S_.leftCols(bilateral_);
    auto y = y_.head(bilateral_);
    if (h < ContactStepRecord::kShortestDifference * nominal_h_) {
      S = 0.5 * (node0_.W.leftCols(bilateral_) + node1_.W.leftCols(bilateral_));
      y.noalias() = S.transpose() * v_;
      y += 0.5 * (node0_.rate + node1_.rate).head(bilateral_) + node0_.phi / nominal_h_;
    } else {
      y = (node1_.phi - (h < nominal_h_ ? 1.0 - h / nominal_h_ : 0.0) * node0_.phi) / h;
    }
  }
  for (int k = 0; k < friction_rows_; ++k) {
    const FrictionJoint& joint = friction_joints_[k];
    y_[bilateral_ + k] = counts_by_place(joint, h) ? (q1_[joint.iq] - joint.reference) / h : v_[joint.dof];
  }
}

// Sets the speeds of the joints with friction at the start of a step; a joint that moves loses its anchor.
void ContactStep::start_joint_friction(const VecCRef& v) {
  const double still = kStill * (1.0 + v.cwiseAbs().maxCoeff());
  for (FrictionJoint& joint : friction_joints_) {
    joint.speed = std::abs(v[joint.dof]) > still ? v[joint.dof] : 0.0;
    joint.anchored &= joint.speed == 0.0;
  }
}

// Which joints with friction have slipped in the step, from the position impulse.
void ContactStep::classify_joint_friction(double speed) {
  for (int k = 0; k < friction_rows_; ++k) {
    FrictionJointOutcome& out = friction_outcomes_[k];
    const int r = bilateral_ + k;
    const double s = y_[r] + G_.row(r) * change_;
    out = FrictionJointOutcome();
    out.slipped = has_slipped(r, Eigen::Matrix<double, 1, 1>(s), cones_[k].box, speed);
    if (!out.slipped) continue;
    cones_[k].d[0] = s > 0.0 ? 1.0 : -1.0;
    out.turned = friction_joints_[k].speed * s < 0.0;
  }
}

bool ContactStep::slip_ends(int i) const {
  const int n = static_cast<int>(contacts_.size());
  if (i >= n + friction_rows_) return roll_ends(static_cast<std::size_t>(i - n - friction_rows_));
  if (i >= n) {
    const FrictionJointOutcome& out = friction_outcomes_[i - n];
    const FrictionJoint& joint = friction_joints_[i - n];
    return joint.speed != 0.0 && (!out.slips || out.turned || joint.speed * v1_[joint.dof] < 0.0);
  }
  const PersistentContact& persistent = contacts_[i];
  const ContactOutcome& out = outcomes_[i];
  const bool turns = out.slips && (out.turned || out.slip_W.dot(persistent.slip) + out.spin * persistent.spin < 0.0);
  return persistent.mu > 0.0 && !persistent.sticks && out.active && (!out.slips || turns);
}

double ContactStep::slip_at_start(int i) const {
  const int n = static_cast<int>(contacts_.size());
  if (i >= n + friction_rows_) return contacts_[i - n - friction_rows_].roll.norm();
  return i < n ? std::hypot(contacts_[i].slip.norm(), contacts_[i].spin) : std::abs(friction_joints_[i - n].speed);
}

double ContactStep::slip_left(int i) const {
  constexpr double kTurned = -std::numeric_limits<double>::infinity();
  const int n = static_cast<int>(contacts_.size());
  if (i >= n + friction_rows_) {
    const ContactOutcome& out = outcomes_[i - n - friction_rows_];
    return out.rolled && !out.roll_turned ? out.roll_reversed : kTurned;
  }
  if (i >= n) {
    const FrictionJointOutcome& out = friction_outcomes_[i - n];
    return out.slipped && !out.turned ? out.reversed : kTurned;
  }
  return outcomes_[i].slipped && !outcomes_[i].turned ? outcomes_[i].reversed : kTurned;
}

// Whether the constraints are satisfied at the end of the step, with `rates` also their rates; else
// violated_constraint_ is the worst of them.
bool ContactStep::constraints_met(double h, bool rates) {
  violated_constraint_ = -1;
  if (bilateral_ == 0) return true;
  const Elements& elements = scene_->tree.elements;
  ConstraintErrors errors{node0_.phi,
                          node1_.phi,
                          VecX::Zero(bilateral_),
                          constraint_reach(node1_.q),
                          1.0,
                          h < nominal_h_ ? 1.0 - h / nominal_h_ : 0.0};
  if (rates) {
    const auto rate = node1_.rate.head(bilateral_);
    errors.rates = node1_.W.leftCols(bilateral_).transpose() * v1_ + rate;
    errors.speed += v1_.cwiseAbs().maxCoeff() + rate.cwiseAbs().maxCoeff();
  }
  violated_constraint_ = find_violated(elements, errors);
  if (violated_constraint_ < 0 && rates)
    violated_constraint_ = find_jump(elements, node1_.W.leftCols(bilateral_).transpose() * v_,
                                     VecX(node0_.rate.head(bilateral_)), VecX(node1_.rate.head(bilateral_)), h);
  if (violated_constraint_ >= 0) why_ = "the constraints cannot be met";
  return violated_constraint_ < 0;
}

ConeContact ContactStep::joint_friction_cone(int k, double bound) const {
  ConeContact cone;
  cone.row = k;
  cone.rows = 1;
  cone.box = bound;
  return cone;
}

// Solves the cone problem of all rows with the constraints eliminated; reduction_ has been set to G before.
bool ContactStep::solve_rows(const std::vector<ConeContact>& cones, const MatX& G, const VecX& b, double noise,
                             VecX& lambda, bool regularize, const Agreement& agreement) {
  const auto [rough, accept] = agreement;
  if (problems_) problems_->add(ProblemLog::Rows{cones, G, b, lambda, bilateral_, noise});
  if (bilateral_ == 0) return solve_cone({cones, G, b, noise, rough, accept, scene_->tree.nv}, lambda, regularize);
  const VecX& right = reduction_.right_side(b);
  rest_ = lambda.tail(right.size());
  if (right.size() > 0 &&
      !solve_cone({cones, reduction_.matrix(), right, noise, rough, accept, scene_->tree.nv}, rest_, regularize))
    return false;
  // Friction of a joint whose motion the constraints determine: it acts in full, and the constraints bear it.
  for (std::size_t i = 0; i < reduction_.idle().size(); ++i) {
    const int k = reduction_.idle()[i];
    const double speed = reduction_.idle_speed(i);
    const double still = std::max(noise, kStill * (1.0 + v_.cwiseAbs().maxCoeff()));
    rest_[k] = std::abs(speed) > still ? -std::copysign(cones[k].box, speed) : 0.0;
  }
  reduction_.complete(rest_, lambda);
  return lambda.allFinite();
}

// An element of the Delassus matrix of the step, with the constraints eliminated.
double ContactStep::contact_matrix(int row, int column) const {
  return bilateral_ == 0 ? G_(row, column) : reduction_.matrix()(row - bilateral_, column - bilateral_);
}

}  // namespace contactvi

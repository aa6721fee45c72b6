// ContactStep: the rows of constraints and of the dry friction of joints.
#include <algorithm>
#include <cmath>

#include "contact/contact_step.hpp"
#include "model/constraints.hpp"

namespace contactvi {

namespace {
constexpr double kShort = 1e-5;   // of a step below which places are followed by their rates
constexpr double kStill = 1e-11;  // of the speeds: slip below it is rounding
constexpr double kJump = 2.0;     // of the rates of a motion at both ends of a step, by which its mean may differ,
constexpr double kJumpRounding = 1e-9;  // and [rad; m], [rad/s; m/s]
constexpr double kFar = 1e-4;           // of the configuration: numbers beyond its inverse have more rounding
constexpr double kMet = 1e-10;          // [m; rad] to which a constraint is met,
constexpr double kMetRate = 1e-7;       // and its rate to this, of the speeds
}  // namespace

// Rows of the constraints and of dry friction; the guards are placed at q.
void ContactStep::constraint_node(const VecCRef& q, double t, Node& node) {
  node.t = t;
  if (bilateral_ > 0)
    evaluate_constraints(scene_->tree, guards_->placements(), q, t, node.phi, node.W.leftCols(bilateral_), node.rate);
  if (friction_rows_ > 0) node.W.middleCols(bilateral_, friction_rows_).setZero();
  for (int k = 0; k < friction_rows_; ++k) node.W(friction_joints_[k].dof, bilateral_ + k) = 1.0;
}

// The same of constraints and dry friction. What a constraint was off at the start goes away over a whole step.
void ContactStep::measure_constraints(double h) {
  if (bilateral_ > 0) {
    auto S = S_.leftCols(bilateral_);
    auto y = y_.head(bilateral_);
    if (h < kShort * nominal_h_) {
      S = 0.5 * (node0_.W.leftCols(bilateral_) + node1_.W.leftCols(bilateral_));
      y.noalias() = S.transpose() * v_;
      y += 0.5 * (node0_.rate + node1_.rate) + node0_.phi / nominal_h_;
    } else {
      y = (node1_.phi - (h < nominal_h_ ? 1.0 - h / nominal_h_ : 0.0) * node0_.phi) / h;
    }
  }
  for (int k = 0; k < friction_rows_; ++k) {
    const FrictionJoint& joint = friction_joints_[k];
    const bool place = joint.iq >= 0 && h >= kShort * nominal_h_;
    y_[bilateral_ + k] = place ? (q1_[joint.iq] - joint.reference) / h : v_[joint.dof];
  }
}

// Speeds at the start of a step; a joint that moves has no anchor.
void ContactStep::start_joint_friction(const VecCRef& v) {
  const double still = kStill * (1.0 + v.cwiseAbs().maxCoeff());
  for (FrictionJoint& joint : friction_joints_) {
    joint.speed = std::abs(v[joint.dof]) > still ? v[joint.dof] : 0.0;
    joint.anchored &= joint.speed == 0.0;
  }
}

// What the first kick says of the slip of joints.
void ContactStep::judge_joint_friction(double speed) {
  for (int k = 0; k < friction_rows_; ++k) {
    FrictionJointOutcome& out = friction_outcomes_[k];
    const int r = bilateral_ + k;
    const double s = y_[r] + G_.row(r) * change_;
    out = FrictionJointOutcome();
    out.slipped = std::abs(lambda_[r]) >= cones_[k].box * (1.0 - 1e-9) && std::abs(s) > kStill * speed;
    if (!out.slipped) continue;
    cones_[k].d[0] = s > 0.0 ? 1.0 : -1.0;
    out.turned = friction_joints_[k].speed * s < 0.0;
  }
}

bool ContactStep::slip_ends(int i) const {
  const int n = static_cast<int>(contacts_.size());
  if (i >= n) {
    const FrictionJointOutcome& out = friction_outcomes_[i - n];
    const FrictionJoint& joint = friction_joints_[i - n];
    return joint.speed != 0.0 && (!out.slips || out.turned || joint.speed * v1_[joint.dof] < 0.0);
  }
  const PersistentContact& persistent = contacts_[i];
  const ContactOutcome& out = outcomes_[i];
  const bool turns = out.slips && (out.turned || out.slip_W.dot(persistent.slip) < 0.0);
  return persistent.mu > 0.0 && !persistent.sticks && out.active && (!out.slips || turns);
}

double ContactStep::slip_left(int i) const {
  constexpr double kTurned = -1e-3;
  const int n = static_cast<int>(contacts_.size());
  if (i >= n) {
    const FrictionJointOutcome& out = friction_outcomes_[i - n];
    return out.slipped && !out.turned ? out.reversed : kTurned;
  }
  return outcomes_[i].slipped && !outcomes_[i].turned ? outcomes_[i].reversed : kTurned;
}

// Whether the constraints hold at the end of the step; else which does not (unmet_). rates: and their rates.
bool ContactStep::constraints_met(double h, bool rates) {
  unmet_ = -1;
  if (bilateral_ == 0) return true;
  VecX rate = VecX::Zero(bilateral_);
  double speed = 1.0;
  if (rates) {
    rate = node1_.W.leftCols(bilateral_).transpose() * v1_ + node1_.rate;
    speed += v1_.cwiseAbs().maxCoeff() + node1_.rate.cwiseAbs().maxCoeff();
  }
  const double left = h < nominal_h_ ? 1.0 - h / nominal_h_ : 0.0,
               reach = std::max(1.0, kFar * node1_.q.cwiseAbs().maxCoeff());
  double worst = 1.0;
  for (const Constraint& c : scene_->tree.elements.constraints)
    for (int k = c.row; k < c.row + c.rows; ++k) {
      const double place = std::abs(node1_.phi[k]) - left * std::abs(node0_.phi[k]);
      const double off = std::max(place / (kMet * reach), std::abs(rate[k]) / (kMetRate * speed));
      if (off <= worst) continue;
      worst = off;
      unmet_ = static_cast<int>(&c - scene_->tree.elements.constraints.data());
    }
  if (unmet_ < 0 && rates) unmet_ = find_jump(h);
  if (unmet_ >= 0) why_ = "the constraints cannot be met";
  return unmet_ < 0;
}

// A joint whose prescribed motion has not gone where its rates lead: the motion jumps. -1: none.
int ContactStep::find_jump(double h) const {
  const std::vector<Constraint>& all = scene_->tree.elements.constraints;
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (all[i].kind != ConstraintKind::kPrescribed) continue;
    const double rate0 = -node0_.rate[all[i].row], rate1 = -node1_.rate[all[i].row];
    const double gone = v_[scene_->tree.joints[all[i].joint_b].iv];
    const double most = kJump * (std::abs(rate0) + std::abs(rate1)) + kJumpRounding * (1.0 + 1.0 / h);
    if (std::abs(gone - 0.5 * (rate0 + rate1)) > most) return static_cast<int>(i);
  }
  return -1;
}

ConeContact ContactStep::joint_friction_cone(int k, double bound) const {
  ConeContact cone;
  cone.row = k;
  cone.rows = 1;
  cone.box = bound;
  return cone;
}

// The cone problem of all rows, the constraints eliminated (reduction_ has been made for G).
bool ContactStep::solve_rows(const std::vector<ConeContact>& cones, const MatX& G, const VecX& b, double noise,
                             VecX& lambda, bool regularize, double rough) {
  if (bilateral_ == 0) return solve_cone({cones, G, b, noise, rough}, lambda, regularize);
  const VecX& right = reduction_.right_side(b);
  rest_ = lambda.tail(right.size());
  if (right.size() > 0 && !solve_cone({cones, reduction_.matrix(), right, noise, rough}, rest_, regularize))
    return false;
  // Friction of a joint that constraints move: it takes its part whatever comes, and they bear it.
  for (std::size_t i = 0; i < reduction_.idle().size(); ++i) {
    const int k = reduction_.idle()[i];
    const double speed = reduction_.idle_speed(i);
    const double still = std::max(noise, kStill * (1.0 + v_.cwiseAbs().maxCoeff()));
    rest_[k] = std::abs(speed) > still ? -std::copysign(cones[k].box, speed) : 0.0;
  }
  reduction_.complete(rest_, lambda);
  return lambda.allFinite();
}

// Of the contact matrix of the step, without what the constraints take up.
double ContactStep::contact_matrix(int row, int column) const {
  return bilateral_ == 0 ? G_(row, column) : reduction_.matrix()(row - bilateral_, column - bilateral_);
}

double ContactStep::joint_friction_loss() const {
  double total = 0.0;
  for (int k = 0; k < friction_rows_; ++k)
    total -= (lambda_[bilateral_ + k] + lambda_end_[bilateral_ + k]) * v_[friction_joints_[k].dof];
  return total;
}

// The force of a constraint that moves by itself has power: the rows' velocities are -rate.
double ContactStep::driven_work() const {
  if (bilateral_ == 0) return 0.0;
  return -lambda_.head(bilateral_).dot(node0_.rate) - lambda_end_.head(bilateral_).dot(node1_.rate);
}

}  // namespace contactvi

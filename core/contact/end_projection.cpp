// ContactStep: the velocity impulse at the end of a step, and the result of the step for its contacts.
#include <algorithm>
#include <cmath>

#include "base/tolerances.hpp"
#include "contact/contact_step.hpp"
#include "contact/delassus.hpp"
#include "contact/persistent_geometry.hpp"
#include "geometry/line_contact.hpp"

namespace contactvi {

namespace {
constexpr double kClosed = 1e-12;  // [m] below this gap a contact without load takes part in the velocity impulse
}  // namespace

// From the end of the step with its position impulses to the node: p1 and v1.
bool ContactStep::velocity_impulses() {
  p_start_.noalias() += node0_.W * change_;  // the correction of the impulses in the last iteration
  integrator_.set_start_momentum(p_start_);
  integrator_.stage_velocity(v_);
  integrator_.finish(q1_, p_minus_);
  end_node(q1_, integrator_.time() + h_);
  integrator_.place_node(q1_);
  right_sides_.resize(p_minus_.size(), rows_ + 1);
  if (adheres_) p_minus_.noalias() -= node1_.W * pull_end_;
  right_sides_ << node1_.W, p_minus_;
  integrator_.solve_masses(right_sides_);
  MinvW_ = right_sides_.leftCols(rows_);
  v1_ = right_sides_.col(rows_);
  if (!v1_.allFinite()) {
    why_ = "a number is not finite";
    return false;
  }
  delassus(node1_.W, MinvW_, G_end_);
  w_end_.noalias() = node1_.W.transpose() * v1_;
  w_end_ += node1_.rate;
  active_.clear();
  const double speed = 1.0 + v_.cwiseAbs().maxCoeff();
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    ContactOutcome& out = outcomes_[i];
    const int r = row_[i];
    out.active = lambda_[r] > 0.0 || node1_.at[i].gap <= kClosed;
    out.slipped = false;
    out.slip.setZero();
    out.reversed = 0.0;
    out.keeps = out.freed = out.roll_keeps = out.roll_freed = false;
    out.turned = false;
    if (out.active) active_.push_back(static_cast<int>(i));
    if (contacts_[i].mu == 0.0) continue;
    if (contacts_[i].rows() > 3) {
      classify_turning(i, speed);
      continue;
    }
    const Eigen::Vector2d s = y_.segment<2>(r + 1) + G_.block(r + 1, 0, 2, rows_) * change_;
    const double limit = cones_[friction_rows_ + i].mu * lambda_[r];
    out.slipped = has_slipped(r + 1, s, limit, speed);
    if (!out.slipped) continue;
    out.slip = s;
    cones_[friction_rows_ + i].d = s.normalized();
    out.turned = contacts_[i].slip.dot(frame(i, node1_).slip(s)) < 0.0;
  }
  classify_joint_friction(speed);
  lambda_end_ = lambda_ + h_ * shift_;
  if (!solve_ends(lambda_end_)) {
    why_ = "the contact forces at the end of a step were not found";
    return false;
  }
  p1_ = p_minus_;
  p1_.noalias() += node1_.W * lambda_end_;
  v1_.noalias() += MinvW_ * lambda_end_;
  w_end_.noalias() += G_end_ * lambda_end_;
  set_outcomes();
  find_jumps();
  return constraints_met(h_, true);
}

// After an attempt at the velocity impulse: frees the direction of friction where the impulse would reverse the slip.
// False: nowhere.
bool ContactStep::unfreeze_turned(const MatX& G, double still) {
  bool turned = false;
  for (int k = 0; k < friction_rows_; ++k) {
    ConeContact& cone = end_cones_[k];
    if (!cone.frozen) continue;
    const int row = bilateral_ + k;
    friction_outcomes_[k].reversed = cone.d[0] * (b_sub_[row] + G.row(row) * x_);
    if (friction_outcomes_[k].reversed > still) continue;
    cone.frozen = false;
    turned = true;
  }
  for (std::size_t a = 0; a < active_.size(); ++a) {
    ConeContact& cone = end_cones_[friction_rows_ + a];
    if (cone.frozen_rolling) {
      const int roll = bilateral_ + cone.row + cone.rolling_row();
      const Eigen::Vector2d w = b_sub_.segment<2>(roll) + G.middleRows<2>(roll) * x_;
      outcomes_[active_[a]].roll_reversed = w.dot(cone.d_rolling);
      cone.frozen_rolling = w.dot(cone.d_rolling) > still;
      turned |= !cone.frozen_rolling;
    }
    if (!cone.frozen) continue;
    const int row = bilateral_ + cone.row + 1;
    const Eigen::Vector2d w = b_sub_.segment<2>(row) + G.middleRows<2>(row) * x_;
    double along = w.dot(cone.d);
    if (cone.spins) along += cone.d_spin * (b_sub_[row + 2] + G.row(row + 2) * x_);
    outcomes_[active_[a]].reversed = along;
    if (along > still) continue;
    cone.frozen = false;
    turned = true;
  }
  return turned;
}

// The velocity impulse with the coefficients of its own forces.
bool ContactStep::solve_ends(VecX& lambda) {
  FrictionRounds rounds;
  do {
    if (!solve_end(lambda)) return false;
  } while (follows_forces_ && rounds.go_on(follow_forces(lambda, 0.5 * h_, cones_)));
  return rounds.settled();
}

// The cone problem of the active contacts; directions of friction stay those of the step where that reverses no slip.
bool ContactStep::solve_end(VecX& lambda) {
  end_cones_.clear();
  sub_rows_.clear();
  for (int k = 0; k < bilateral_ + friction_rows_; ++k) sub_rows_.push_back(k);
  for (int k = 0; k < friction_rows_; ++k) {
    end_cones_.push_back(cones_[k]);
    end_cones_.back().frozen = friction_outcomes_[k].slipped;
  }
  for (int i : active_) {
    ConeContact cone = cones_[friction_rows_ + i];
    cone.row = static_cast<int>(sub_rows_.size()) - bilateral_;
    cone.frozen = outcomes_[i].slipped;
    cone.frozen_rolling = outcomes_[i].rolled;
    end_cones_.push_back(cone);
    for (int k = 0; k < cone.rows; ++k) sub_rows_.push_back(row_[i] + k);
  }
  // The problem has the rows of the active contacts only.
  const int rows = static_cast<int>(sub_rows_.size());
  MatX& G = G_sub_;
  G.resize(rows, rows);
  b_sub_.resize(rows);
  x_.resize(rows);
  for (int a = 0; a < rows; ++a) {
    b_sub_[a] = w_end_[sub_rows_[a]];
    x_[a] = lambda[sub_rows_[a]];
    for (int c = 0; c < rows; ++c) G(a, c) = G_end_(sub_rows_[a], sub_rows_[c]);
  }
  if (bilateral_ > 0) reduction_.set(G, bilateral_, friction_rows_);
  const double speed = 1.0 + v_.cwiseAbs().maxCoeff();
  lambda.setZero();
  if (rows == 0) return true;
  for (int attempt = 0; attempt < 3; ++attempt) {
    if (!solve_rows(end_cones_, G, b_sub_, kStill * 1e-3 * speed, x_, true, Agreement())) {
      // In Painleve's paradox no force keeps a contact closed that goes on slipping.
      bool frozen = false;
      for (ConeContact& cone : end_cones_) {
        frozen |= cone.frozen || cone.frozen_rolling;
        cone.frozen = cone.frozen_rolling = false;
      }
      if (!frozen) return false;
      x_.setZero();
      continue;
    }
    const bool turned = unfreeze_turned(G, kStill * speed);
    note_kept_directions(attempt == 0);
    if (!turned) break;
  }
  for (int a = 0; a < rows; ++a) lambda[sub_rows_[a]] = x_[a];
  return true;
}

// Which of the contacts and joints that slipped keep their direction of friction. first: after the first attempt, in
// which all of them did.
void ContactStep::note_kept_directions(bool first) {
  for (int k = 0; k < friction_rows_; ++k) {
    FrictionJointOutcome& out = friction_outcomes_[k];
    out.keeps = end_cones_[k].frozen;
    if (first) out.freed = out.slipped && !out.keeps;
  }
  for (std::size_t a = 0; a < active_.size(); ++a) {
    ContactOutcome& out = outcomes_[active_[a]];
    out.keeps = end_cones_[friction_rows_ + a].frozen;
    out.roll_keeps = end_cones_[friction_rows_ + a].frozen_rolling;
    if (!first) continue;
    out.freed = out.slipped && !out.keeps;
    out.roll_freed = out.rolled && !out.roll_keeps;
  }
}

// Whether friction in these rows, with this bound, has slipped in the step: the piece of the natural map that holds
// there. How near to its bound it is tells less, since a slip may be known much better than the friction against it.
bool ContactStep::has_slipped(int row, const Eigen::Ref<const VecX>& slip, double bound, double speed) const {
  const Eigen::Index rows = slip.size();
  const double mobility = G_.diagonal().segment(row, rows).cwiseAbs().maxCoeff();
  return slip.norm() > kStill * speed && (mobility * lambda_.segment(row, rows) - slip).norm() > mobility * bound;
}

void ContactStep::set_outcomes() {
  for (int k = 0; k < friction_rows_; ++k)
    friction_outcomes_[k].slips = std::abs(v1_[friction_joints_[k].dof]) > kStill * (1.0 + v1_.cwiseAbs().maxCoeff());
  const double speed = 1.0 + v1_.cwiseAbs().maxCoeff();
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    ContactOutcome& out = outcomes_[i];
    const PersistentContact& persistent = contacts_[i];
    const int r = row_[i];
    const Contact &c0 = node0_.at[i], &c1 = node1_.at[i];
    out.contact = c1;
    out.t1 = node1_.t1[i];
    const TangentFrame start = frame(i, node0_), end = frame(i, node1_);
    out.t2 = end.t2;
    out.w_n = w_end_[r];
    out.position_impulse = Vec3(lambda_[r], 0, 0);
    out.velocity_impulse = Vec3(lambda_end_[r], 0, 0);
    out.slip_W.setZero();
    out.friction_work = 0.0;
    out.paradox = paradox_[i];
    out.slips = false;
    if (persistent.mu > 0.0) {
      out.position_impulse.tail<2>() = lambda_.segment<2>(r + 1);
      out.velocity_impulse.tail<2>() = lambda_end_.segment<2>(r + 1);
      out.slip_W = end.slip(w_end_.segment<2>(r + 1));
      out.slips = out.slip_W.norm() > kStill * speed;
    }
    if (persistent.mu > 0.0 && !(persistent.sticks && !out.slipped && !out.slips)) {
      const Eigen::Vector2d before = slip_before(i);
      const Eigen::Vector2d own = 0.5 * (node0_.rate + node1_.rate).segment<2>(r + 1);
      const Eigen::Vector2d during(0.5 * (node0_.W.col(r + 1) + node1_.W.col(r + 1)).dot(v_) + own[0],
                                   0.5 * (node0_.W.col(r + 2) + node1_.W.col(r + 2)).dot(v_) + own[1]);
      const Eigen::Vector2d after(w_end_[r + 1], w_end_[r + 2]);
      out.friction_work = 0.5 * (out.position_impulse.tail<2>().dot(before + during) +
                                 out.velocity_impulse.tail<2>().dot(during + after));
    }
    if (persistent.rows() > 3) set_turning_outcome(i, speed);
    const bool pulled = adheres_ && h_ > 0.0;
    const double first = out.position_impulse[0] - (pulled ? pull_[r] : 0.0);
    const double second = out.velocity_impulse[0] - (pulled ? pull_end_[r] : 0.0);
    out.position_impulse_W = first * c0.normal + start.force(out.position_impulse.tail<2>());
    out.velocity_impulse_W = second * c1.normal + end.force(out.velocity_impulse.tail<2>());
  }
}

ContactStepRecord ContactStep::record() const {
  ContactStepRecord r;
  r.t = integrator_.time();
  r.h = h_;
  r.nominal = nominal_h_;
  r.q0 = node0_.q;
  r.p_start = p_start_;
  r.q1 = q1_;
  r.p_minus = p_minus_;
  r.p1 = p1_;
  r.v = v_;
  r.v1 = v1_;
  r.lambda = lambda_;
  r.lambda_end = lambda_end_;
  r.W0 = node0_.W;
  r.W1 = node1_.W;
  r.constrained = bilateral_ > 0;
  const double still = kStill * (1.0 + v1_.cwiseAbs().maxCoeff());
  for (int k = 0; k < friction_rows_; ++k) {
    const FrictionJoint& joint = friction_joints_[k];
    const FrictionJointOutcome& out = friction_outcomes_[k];
    r.joints.push_back({joint.dof, joint.iq, joint.limit, counts_by_place(joint, h_), joint.anchored, out.slipped,
                        out.slips, out.keeps, out.freed, std::abs(v1_[joint.dof]) <= still && joint.iq >= 0});
  }
  for (std::size_t i = 0; i < contacts_.size(); ++i)
    r.contacts.push_back({contacts_[i], node0_.at[i], node1_.at[i], node0_.t1[i], node1_.t1[i], outcomes_[i], row_[i],
                          counts_by_rate(contacts_[i], h_)});
  r.share = 0.0;
  r.ending = ContactStepEnd::kLength;
  r.ended = -1;
  return r;
}

ContactStep::Memory ContactStep::memory() const {
  return {contacts_,    outcomes_,  node0_,   reference_positions_,  friction_joints_,      fixed_force_,
          v_node_,      v1_,        shift_,   velocities_.history(), row_forces_.history(), p1_,
          contraction_, nominal_h_, follows_, modes_known_};
}

void ContactStep::recall(const Memory& memory) {
  contacts_ = memory.contacts;
  set_rows();
  outcomes_ = memory.outcomes;
  node0_ = memory.node;
  node1_.known = false;
  reference_positions_ = memory.reference_positions;
  friction_joints_ = memory.friction_joints;
  fixed_force_ = memory.fixed_force;
  v_node_ = memory.v_node;
  v1_ = memory.v1;
  shift_ = memory.shift;
  velocities_.recall(memory.velocities);
  row_forces_.recall(memory.row_forces);
  p1_ = memory.p1;
  contraction_ = memory.contraction;
  forget_parts();
  nominal_h_ = memory.nominal_h;
  follows_ = memory.follows;
  modes_known_ = memory.modes_known;
}

bool ContactStep::rim_turns_far() const {
  for (std::size_t i = 0; i < contacts_.size(); ++i)
    if (contacts_[i].point.kind == PointKind::kRim && node0_.side[i].dot(node1_.side[i]) < kSwing) return true;
  return false;
}

bool ContactStep::runs_along_lines() const {
  if (!node1_.known) return false;  // the step has not come to an end
  for (std::size_t i = 0; i < contacts_.size(); ++i)
    if (manifolds_->run(contacts_[i].point, node0_.along[i], node1_.along[i]) > kMostRun) return true;
  return false;
}

void ContactStep::commit() {
  guards_->place(q1_);
  forget_parts();
  bool kink = false;  // a slip begins or ends
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    PersistentContact& persistent = contacts_[i];
    const ContactOutcome& out = outcomes_[i];
    persistent.force = (out.position_impulse + out.velocity_impulse) / h_;
    if (persistent.mu > 0.0 && persistent.point.kind != PointKind::kVertex) persistent.tangent = node1_.t1[i];
    kink = kink || persistent.sticks == out.slips;
    persistent.sticks = !out.slips;
    persistent.slip = out.slip_W;
    set_coefficient(persistent, integrator_.time() + h_);
    if (persistent.rows() > 3) {
      persistent.turning_force = (out.position_turning + out.velocity_turning) / h_;
      kink = kink || persistent.roll.isZero(0.0) == out.rolls;
      persistent.spin = out.spin;
      persistent.roll = out.roll_W;
    }
    persistent.heading.setZero();
    if (!persistent.counts_by_place()) continue;
    if (out.slips || out.slipped) persistent.anchored = false;
    if (!out.slips && !persistent.anchored) {
      persistent.anchor = geometry_.position_on_plane(persistent.point);
      persistent.anchored = true;
    }
    reference_positions_[i] = geometry_.reference(persistent);
  }
  const double still = kStill * (1.0 + v1_.cwiseAbs().maxCoeff());
  for (FrictionJoint& joint : friction_joints_) {
    const bool sticks = std::abs(v1_[joint.dof]) <= still && joint.iq >= 0;
    if (sticks && !joint.anchored) joint.anchor = q1_[joint.iq];
    kink = kink || sticks != joint.anchored;
    joint.anchored = sticks;
  }
  fixed_force_ = (lambda_.head(bilateral_ + friction_rows_) + lambda_end_.head(bilateral_ + friction_rows_)) / h_;
  v_node_ = v1_;
  // What lies before a kink says nothing about the motion after it.
  if (kink) {
    velocities_.clear();
    row_forces_.clear();
    velocities_.push(v_node_, 0.0);
  } else {
    if (velocities_.empty()) velocities_.push(v_start_, 0.0);
    velocities_.push(v_, h_);
  }
  row_forces_.push(solved_forces_, h_);
  follows_ = true;
  modes_known_ = false;
  std::swap(node0_, node1_);
  node1_.known = false;
}

}  // namespace contactvi

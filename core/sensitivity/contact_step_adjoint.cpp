#include "sensitivity/contact_step_adjoint.hpp"

#include <cmath>

#include "base/numerics.hpp"
#include "sensitivity/stage_velocity.hpp"

namespace contactvi {

ContactStepAdjoint::ContactStepAdjoint(const Scene& scene, Kinks& kinks)
    : scene_(&scene),
      tangent_(scene, kinks),
      adjoint_(scene.tree, 1),
      W0_of_q0_(static_cast<std::size_t>(scene.tree.nv)),
      W1_of_q0_(W0_of_q0_),
      W1_of_q1_(W0_of_q0_),
      work_(scene.tree.nv) {}

void ContactStepAdjoint::take(const ContactStepRecord& step, const VecX& tau, const Servo* servo) {
  tangent_.take(step, tau, servo);
  adjoint_.take(step.q0, step.p_start, step.h, tau, step.t, servo, step.v);
  set_matrices();
}

void ContactStepAdjoint::set_matrices() {
  ContactStepTangent& t = tangent_;
  const ContactStepRecord& s = *t.record_;
  const int n = scene_->tree.nv, contacts = static_cast<int>(s.contacts.size()),
            joints = static_cast<int>(s.joints.size());
  const VecX& none = t.none_;
  const ContactStepDirection nothing;
  VecX unit = none, dy;
  for (MatX* Y : {&y_of_q0_, &y_of_q1_, &y_of_v_, &own_of_q0_, &own_of_q1_}) Y->resize(t.rows_, n);
  for (int k = 0; k < n; ++k) {
    unit[k] = 1.0;
    t.set_start_rows(unit, 0.0);
    t.set_end_rows(none, 0.0);
    W0_of_q0_[k] = t.dW0_;
    W1_of_q0_[k] = t.dW1_;
    own_of_q0_.col(k) = t.down1_;
    t.row_changes(unit, none, none, nothing, dy);
    y_of_q0_.col(k) = dy;
    t.set_start_rows(none, 0.0);
    t.set_end_rows(unit, 0.0);
    W1_of_q1_[k] = t.dW1_;
    own_of_q1_.col(k) = t.down1_;
    t.row_changes(none, unit, none, nothing, dy);
    y_of_q1_.col(k) = dy;
    t.set_end_rows(none, 0.0);
    t.row_changes(none, none, unit, nothing, dy);
    y_of_v_.col(k) = dy;
    unit[k] = 0.0;
  }
  ContactStepDirection direction;
  direction.h = 1.0;
  t.set_start_rows(none, 0.0);
  t.set_end_rows(none, 1.0);
  own_of_t_ = t.down1_;
  t.row_changes(none, none, none, direction, y_of_h_);
  direction.h = 0.0;
  direction.t = 1.0;
  t.set_start_rows(none, 1.0);
  t.row_changes(none, none, none, direction, y_of_t_);
  t.set_start_rows(none, 0.0);
  t.set_end_rows(none, 0.0);
  direction.t = 0.0;
  direction.anchors.setZero(3, contacts);
  y_of_anchors_.resize(t.rows_, 3 * contacts);
  for (int k = 0; k < 3 * contacts; ++k) {
    direction.anchors(k % 3, k / 3) = 1.0;
    t.row_changes(none, none, none, direction, dy);
    y_of_anchors_.col(k) = dy;
    direction.anchors(k % 3, k / 3) = 0.0;
  }
  direction.joints.setZero(joints);
  y_of_joints_.resize(t.rows_, joints);
  for (int k = 0; k < joints; ++k) {
    direction.joints[k] = 1.0;
    t.row_changes(none, none, none, direction, dy);
    y_of_joints_.col(k) = dy;
    direction.joints[k] = 0.0;
  }
}

// The transpose of law_change(). ldy: in the slip over the step.
void ContactStepAdjoint::law_gradient(const Problem& problem, const VecX& lc, VecX& lbase, VecX& ldy) {
  using Mode = ContactStepTangent::Mode;
  const ContactStepRecord& s = *tangent_.record_;
  lbase.head(tangent_.constraints_) += lc.head(tangent_.constraints_);
  for (std::size_t k = 0; k < s.joints.size(); ++k) {
    const int r = tangent_.joint_row(k);
    if (problem.joints[k] == Mode::kKept) {
      lh_ -= lc[r] * problem.lambda[r] / s.h;
    } else {
      lbase[r] += lc[r];
    }
  }
  for (std::size_t i = 0; i < s.contacts.size(); ++i)
    if (!problem.open[i]) lbase[s.contacts[i].row] += lc[s.contacts[i].row];
  for (std::size_t k = 0; k < tangent_.frictions_.size(); ++k) {
    const ContactStepTangent::Friction& f = tangent_.frictions_[k];
    const auto& [row, count, rolls] = f.rows;
    const Mode mode = problem.frictions[k];
    if (mode == Mode::kOpen) continue;
    if (mode == Mode::kStick) {
      lbase.segment(row, count) += lc.segment(row, count);
      continue;
    }
    const VecX slip = tangent_.slip_of(problem, k), l = problem.lambda[f.normal] * lc.segment(row, count);
    const ContactStepTangent::Coefficient& own = tangent_.of(problem, f);
    const double lmu = slip.normalized().dot(l);
    if (!rolls) lmu_[static_cast<Eigen::Index>(f.contact)] += lmu;
    lt_ += own.by_time * lmu;
    lh_ += 0.5 * own.by_time * lmu;
    if (own.by_normal != 0.0) lh_ -= own.by_normal * tangent_.force_of(problem, f) * lmu / s.h;
    VecX& changed = mode == Mode::kKept ? ldy : lbase;
    changed.segment(row, count) += own.mu * tangent_.turn(problem, k).transpose() * l;
    ldy.segment(row, count) += tangent_.friction_by_slip(problem, slip, f).transpose() * l;
  }
}

// The transpose of end_change(): llambda, lw in the changes of the impulses and of the speeds of the rows.
void ContactStepAdjoint::end_gradient(const Problem& problem, const VecX& v, VecX llambda, const VecX& lw,
                                      StepParameters& sums) {
  const ContactStepRecord& s = *tangent_.record_;
  VecX lbase = lw;
  llambda.noalias() += tangent_.G_.transpose() * lw;
  law_gradient(problem, problem.system.solve_transposed(llambda), lbase, ldy_);
  if (tangent_.constraints_ > 0) {
    const ConstraintTangent& end = tangent_.end_constraints_;
    const VecX lrates = lbase.head(tangent_.constraints_);
    const double later = end.accelerations().dot(lrates);
    lt_ += later;
    lh_ += later;
    lq1_ += end.gradient_rates() * lrates;
  }
  lq0_.noalias() += own_of_q0_.transpose() * lbase;
  lq1_.noalias() += own_of_q1_.transpose() * lbase;
  const double later = own_of_t_.dot(lbase);
  lt_ += later;
  lh_ += later;
  const VecX m = tangent_.MinvW_ * lbase;
  lp_minus_ += m;
  lW1_ += m * tangent_.given(problem.lambda, 1).transpose() + v * lbase.transpose();
  pass_pull(1, s.W1, m);
  VecX lq(scene_->tree.nv);
  adjoint_.momentum(s.q1, v, -m, lq, work_);
  lq1_ += lq;
  adjoint_.add_momentum_parameters(s.q1, v, -m, sums);
}

// lp: the gradient in the momentum from which the adhesion at an end is taken.
void ContactStepAdjoint::pass_pull(int end, const MatX& W, const VecX& lp) {
  const VecX lpull = -W.transpose() * lp;
  lt_ += lpull.dot(tangent_.pull_change(end, 1.0, 0.0));
  lh_ += lpull.dot(tangent_.pull_change(end, 0.0, 1.0));
}

bool ContactStepAdjoint::solve(const VecX& lq, const VecX& lp, double lslip, ContactStepGradient& g,
                               StepParameters& sums) {
  const ContactStepTangent& t = tangent_;
  const ContactStepRecord& s = *t.record_;
  const int n = scene_->tree.nv, contacts = static_cast<int>(s.contacts.size());
  const VecX none = VecX::Zero(t.rows_);
  lq1_ = lq;
  lp_minus_ = lp;
  lq0_ = VecX::Zero(n);
  ldy_ = none;
  lW1_ = lp * t.given(s.lambda_end, 1).transpose();
  lh_ = lt_ = 0.0;
  pass_pull(1, s.W1, lp);
  lmu_ = VecX::Zero(contacts);
  if (t.slip_ends_ && lslip != 0.0) {
    VecX lw = none;
    if (const int joint = t.ended_joint(); joint >= 0) {
      lw[t.joint_row(static_cast<std::size_t>(joint))] = lslip;
    } else {
      const ContactStepTangent::Friction& f = t.ended_friction();
      const auto& [row, count, rolls] = f.rows;
      lw.segment(row, count) = lslip * f.slip.normalized();
      ldy_.segment(row, count) = lslip * turn_of(f.slip).transpose() * t.frozen_.w.segment(row, count);
    }
    end_gradient(t.frozen_, t.v_frozen_, none, lw, sums);
  }
  end_gradient(t.velocity_, s.v1, s.W1.transpose() * lp, none, sums);
  for (int k = 0; k < n; ++k) {
    lq1_[k] += W1_of_q1_[k].cwiseProduct(lW1_).sum();
    lq0_[k] += W1_of_q0_[k].cwiseProduct(lW1_).sum();
  }
  const int m = t.constraints_;
  if (m > 0) {
    const double later = t.end_constraints_.gradient_rates().cwiseProduct(lW1_.leftCols(m)).sum();
    lt_ += later;
    lh_ += later;
  }
  // The position impulse.
  const VecX llambda = t.Y_.transpose() * ldy_ + t.P_.transpose() * lp_minus_ + t.Q_.transpose() * lq1_;
  VecX lbase = ldy_;
  law_gradient(t.position_, t.position_.system.solve_transposed(llambda), lbase, lbase);
  lq0_.noalias() += y_of_q0_.transpose() * lbase;
  lq1_.noalias() += y_of_q1_.transpose() * lbase;
  lh_ += y_of_h_.dot(lbase);
  lt_ += y_of_t_.dot(lbase);
  g.anchors = (y_of_anchors_.transpose() * lbase).reshaped(3, contacts);
  g.joints = y_of_joints_.transpose() * lbase;
  fold_velocity(scene_->tree, s.h, s.v, y_of_v_.transpose() * lbase, lq0_, lq1_, lh_);
  // The smooth step.
  g.q.resize(n);
  g.p.resize(n);
  g.tau.resize(n);
  if (!adjoint_.solve(lq1_, lp_minus_, g.q, g.p, g.h, g.tau)) return false;
  pass_pull(0, s.W0, g.p);
  adjoint_.add_time(lt_, lh_);
  adjoint_.add_parameters(sums);
  const MatX lW0 = g.p * t.given(s.lambda, 0).transpose();
  for (int k = 0; k < n; ++k) g.q[k] += lq0_[k] + W0_of_q0_[k].cwiseProduct(lW0).sum();
  if (m > 0) lt_ += t.start_constraints_.gradient_rates().cwiseProduct(lW0.leftCols(m)).sum();
  g.h += lh_;
  g.t = lt_;
  g.mu = lmu_;
  return true;
}

VecX ContactStepAdjoint::place_gradient(int contact, const Vec3& lplace) {
  VecX unit = tangent_.none_, found(unit.size());
  for (Eigen::Index k = 0; k < unit.size(); ++k) {
    unit[k] = 1.0;
    found[k] = lplace.dot(tangent_.place_change(contact, unit));
    unit[k] = 0.0;
  }
  return found;
}

}  // namespace contactvi

#include "sensitivity/contact_step_tangent.hpp"
#include "sensitivity/kinks.hpp"
#include "sensitivity/known_laws.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {
constexpr double kLaw = 1e-7;  // of the impulses and speeds: to which the step satisfies its laws
}  // namespace

ContactStepTangent::ContactStepTangent(const Scene& scene, Kinks& kinks)
    : scene_(&scene),
      kinks_(&kinks),
      masses_(scene.tree, 1, 1e-12, 1),
      step_(scene.tree, 1),
      twists0_(scene.tree),
      twists1_(scene.tree),
      start_constraints_(scene.tree),
      end_constraints_(scene.tree),
      dv_(scene.tree.nv),
      dp_start_(scene.tree.nv),
      dp_minus_(scene.tree.nv),
      work_(scene.tree.nv),
      none_(VecX::Zero(scene.tree.nv)) {}

void ContactStepTangent::refuse(const char* reason, int guard, const std::string& fact, const char* expected,
                                const std::string& got, const char* remedy) const {
  throw NoDerivative({reason, guard, record_->t}, fact, expected, got, remedy);
}

void ContactStepTangent::meet(const char* reason, int guard, const std::string& fact, const char* expected,
                              const std::string& got, const char* remedy) const {
  kinks_->meet(NoDerivative({reason, guard, record_->t}, fact, expected, got, remedy));
}

void ContactStepTangent::take(const ContactStepRecord& step, const VecX& tau, const Servo* servo) {
  record_ = &step;
  margin_ = 1.0;
  slip_change_ = 0.0;
  slip_ends_ = false;
  const auto require = step.from_file ? require_plain_law : require_known_law;
  for (const auto& c : step.contacts) require(*scene_, c.before.point.guard, step.t);
  rows_ = static_cast<int>(step.lambda.size());
  constraints_ = step.constrained ? start_constraints_.rows() : 0;
  twists0_.place(step.q0);
  twists1_.place(step.q1);
  if (constraints_ > 0) {
    start_constraints_.take(step.q0, step.t);
    end_constraints_.take(step.q1, step.t + step.h);
  }
  take_contacts();
  take_laws();
  step_.take(step.q0, step.p_start, step.h, tau, step.t, servo, step.v);
  take_position_problem();
  masses_.place_node(step.q1);
  MinvW_ = step.W1;
  masses_.solve_masses(MinvW_);
  G_.noalias() = step.W1.transpose() * MinvW_;
  w_minus_.noalias() = MinvW_.transpose() * step.p_minus;
  w_minus_ += own_end_;
  if (constraints_ > 0) w_minus_.head(constraints_) += end_constraints_.rates();
  velocity_.lambda = step.lambda_end;
  velocity_.w.noalias() = step.W1.transpose() * step.v1;
  velocity_.w += own_end_;
  velocity_.joints.clear();
  velocity_.contacts.clear();
  for (std::size_t k = 0; k < step.joints.size(); ++k) {
    const ContactStepRecord::Joint& joint = step.joints[k];
    velocity_.joints.push_back(joint.keeps || joint.slips ? Mode::kKept : Mode::kStick);
  }
  bool limited = false;
  for (std::size_t i = 0; i < step.contacts.size(); ++i) {
    const ContactStepRecord::Contact& c = step.contacts[i];
    const ContactOutcome& out = c.outcome;
    Mode mode = Mode::kStick;
    if (!out.active || !(step.lambda_end[c.row] > 0.0)) {
      mode = Mode::kOpen;
    } else if (c.before.mu > 0.0 && out.keeps) {
      mode = Mode::kKept;
    } else if (c.before.mu > 0.0 && out.slips) {
      const bool follows = follows_slip(c, mu_[i], step.lambda_end, velocity_.w.segment<2>(c.row + 1));
      if (follows) mode = Mode::kSlip;
      limited |= !follows;
    }
    velocity_.contacts.push_back(mode);
  }
  if (limited) meet_limit_of_friction();
  check_laws();
  set_laws(velocity_, G_);
  check_shared(velocity_, MinvW_);
  if (step.ending == ContactStepEnd::kStick) take_released_friction();
}

// Whether the friction of a contact in either problem is against its slip. Of a slip that is as small as what the step
// leaves of its equations it may not be: then the contact is at the limit of its friction, and sticks.
bool ContactStepTangent::follows_slip(const ContactStepRecord::Contact& c, double mu, const VecX& lambda,
                                      const Eigen::Vector2d& slip) const {
  if (slip.norm() > kLaw * (1.0 + record_->v.cwiseAbs().maxCoeff())) return true;
  const double limit = mu * lambda[c.row];
  return (lambda.segment<2>(c.row + 1) + limit * slip.normalized()).norm() <= kLaw * limit;
}

void ContactStepTangent::meet_limit_of_friction() const {
  meet("friction", -1, "A persistent contact changes between sticking and slipping",
       "friction inside of its limit, or slip", "the limit of friction without slip", "Start elsewhere");
}

// The geometry of the contacts at both ends, and what they do in the step.
void ContactStepTangent::take_contacts() {
  const ContactStepRecord& s = *record_;
  const std::size_t n = s.contacts.size();
  while (start_.size() < n) {
    start_.emplace_back(*scene_);
    end_.emplace_back(*scene_);
  }
  start_surfaces_.assign(n, SurfaceVelocityTangent());
  end_surfaces_.assign(n, SurfaceVelocityTangent());
  mu_.assign(n, 0.0);
  mu_slope_.assign(n, 0.0);
  directed_.assign(n, 0);
  own_end_.setZero(rows_);
  position_.lambda = s.lambda;
  position_.w.setZero(rows_);
  dn0_.assign(n, Vec3::Zero());
  dt1_.assign(n, Vec3::Zero());
  position_.contacts.clear();
  position_.joints.clear();
  for (std::size_t k = 0; k < s.joints.size(); ++k) {
    const double bound = 0.5 * s.h * s.joints[k].limit, friction = std::abs(s.lambda[joint_row(k)]);
    const bool at_bound = friction >= bound * (1.0 - kOnCone);
    if (bound > 0.0 && !s.joints[k].slipped) margin_ = std::min(margin_, 1.0 - friction / bound);
    position_.joints.push_back(at_bound ? Mode::kKept : Mode::kStick);
  }
  const double speed = s.v.cwiseAbs().maxCoeff();
  double largest = 0.0;
  for (const ContactStepRecord::Contact& c : s.contacts) largest = std::max(largest, s.lambda[c.row]);
  for (std::size_t i = 0; i < n; ++i) {
    const ContactStepRecord::Contact& c = s.contacts[i];
    const int guard = c.before.point.guard;
    if (!start_[i].take(s.q0, guard, c.start, &c.before.point) || !end_[i].take(s.q1, guard, c.end, &c.before.point)) {
      const std::string why = *start_[i].why() != 0 ? start_[i].why() : end_[i].why();
      refuse("witness", guard, "The gap of a persistent contact has no second derivative", "one pair of nearest points",
             why, "Start elsewhere, or round the edges of the shapes");
    }
    if (c.before.mu > 0.0) {
      const double speed_of_slip = c.outcome.slip.norm();
      mu_[i] = c.before.mu;
      if (scene_->friction_varies(guard))
        mu_[i] = c.before.sticks ? scene_->static_friction(guard) : scene_->sliding_friction(guard, speed_of_slip);
      if (!c.before.sticks && scene_->law(guard) != nullptr && scene_->law(guard)->mu.given() && speed_of_slip > 0.0)
        mu_slope_[i] = scene_->law(guard)->mu.slope(speed_of_slip);
      start_surfaces_[i].take(*scene_, guard, start_[i], c.t1_start, s.t);
      end_surfaces_[i].take(*scene_, guard, end_[i], c.t1_end, s.t + s.h);
      own_end_.segment<2>(c.row + 1) = end_surfaces_[i].velocity();
    }
    const double normal = s.lambda[c.row];
    if (!(normal > 0.0)) {
      position_.contacts.push_back(Mode::kOpen);
      continue;
    }
    if (c.before.mu == 0.0) {
      position_.contacts.push_back(Mode::kStick);
      continue;
    }
    const double limit = mu_[i] * normal, friction = s.lambda.segment<2>(c.row + 1).norm();
    directed_[i] = c.outcome.slipped && follows_slip(c, mu_[i], s.lambda, c.outcome.slip);
    position_.contacts.push_back(directed_[i] ? Mode::kSlip : Mode::kStick);
    if (c.outcome.slipped && !directed_[i]) margin_ = 0.0;
    position_.w.segment<2>(c.row + 1) = c.outcome.slip;
    margin_ =
        std::min(margin_, c.outcome.slipped ? c.outcome.slip.norm() / (speed + 1e-300) : (limit - friction) / largest);
  }
  if (margin_ < kOnCone) meet_limit_of_friction();
}

// Adhesion, half of it at each end.
void ContactStepTangent::take_laws() {
  const ContactStepRecord& s = *record_;
  for (int end = 0; end < 2; ++end) {
    for (VecX* sums : {&pull_[end], &pull_by_t_[end], &pull_by_h_[end]}) sums->setZero(rows_);
    const double t = end == 0 ? s.t : s.t + s.h;
    for (const ContactStepRecord::Contact& c : s.contacts) {
      const double force = adhesion(*scene_, c.before, t);
      if (force == 0.0) continue;
      const double rate = c.before.pull_share * scene_->law(c.before.point.guard)->pull.slope(t);
      pull_[end][c.row] = 0.5 * s.h * force;
      pull_by_t_[end][c.row] = 0.5 * s.h * rate;
      pull_by_h_[end][c.row] = 0.5 * (force + (end == 0 ? 0.0 : s.h * rate));
    }
  }
}

// The step must satisfy the laws that are differentiated, with the modes that were found.
void ContactStepTangent::check_laws() {
  const ContactStepRecord& s = *record_;
  const double speed = 1.0 + s.v1.cwiseAbs().maxCoeff();
  const int others = rows_ - constraints_;
  const double impulse =
      std::max(s.lambda.tail(others).lpNorm<Eigen::Infinity>(), s.lambda_end.tail(others).lpNorm<Eigen::Infinity>());
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const ContactStepRecord::Contact& c = s.contacts[i];
    const double mu = mu_[i];
    double off_impulse = 0.0, off_speed = 0.0;
    const Mode end = velocity_.contacts[i];
    if (end != Mode::kOpen) off_speed = std::abs(velocity_.w[c.row]);
    if (mu > 0.0 && position_.contacts[i] == Mode::kSlip)
      off_impulse = (s.lambda.segment<2>(c.row + 1) + mu * s.lambda[c.row] * c.outcome.slip.normalized()).norm();
    if (mu > 0.0 && (end == Mode::kKept || end == Mode::kSlip)) {
      const Eigen::Vector2d along = slip_of(velocity_, i).normalized();
      const Eigen::Vector2d off = s.lambda_end.segment<2>(c.row + 1) + mu * s.lambda_end[c.row] * along;
      off_impulse = std::max(off_impulse, off.norm());
    } else if (mu > 0.0 && end == Mode::kStick) {
      off_speed = std::max(off_speed, velocity_.w.segment<2>(c.row + 1).norm());
      const double inside = mu * s.lambda_end[c.row] - s.lambda_end.segment<2>(c.row + 1).norm();
      margin_ = std::min(margin_, std::abs(inside) / impulse);
    }
    if (off_impulse > kLaw * impulse || off_speed > kLaw * speed)
      refuse("contact", c.before.point.guard, "The impulses of a persistent contact do not satisfy one law of friction",
             "a contact that is open, sticks or slips", "something in between", "Use a smaller dt");
  }
}

// The effect of each position impulse, and the equations for their changes.
void ContactStepTangent::take_position_problem() {
  const ContactStepRecord& s = *record_;
  const int n = scene_->tree.nv;
  Y_.resize(rows_, rows_);
  dW0_.resize(n, rows_);
  dW1_.resize(n, rows_);
  set_start_rows(none_, 0.0);
  if (!step_.unit_changes(s.W0.leftCols(rows_), Q_, P_, V_))
    refuse("step", -1, "The derivative of a step was not solved", "tangent equations with a solution", "none",
           "Use a smaller dt");
  const ContactStepDirection nothing;
  VecX dy;
  for (int r = 0; r < rows_; ++r) {
    const VecX dq = Q_.col(r);
    dv_ = V_.col(r);
    set_end_rows(dq, 0.0);
    row_changes(none_, dq, dv_, nothing, dy);
    Y_.col(r) = dy;
  }
  set_laws(position_, Y_);
  check_shared(position_, P_);
  check_shared(position_, V_);
}

// d(s / |s|) / ds.
Eigen::Matrix2d ContactStepTangent::turn(const Eigen::Vector2d& s) const {
  const Eigen::Vector2d d = s.normalized();
  return (Eigen::Matrix2d::Identity() - d * d.transpose()) / s.norm();
}

// Velocity along the direction of x on the body of the contact's point, less that of x on the body of its plane.
Vec3 ContactStepTangent::relative(const BodyTwists& twists, int contact, const Vec3& x) const {
  const ContactPoint& p = record_->contacts[contact].before.point;
  return twists.velocity(p.point_body, x) - twists.velocity(p.plane_body, x);
}

// The centre of the contact's point, world.
Vec3 ContactStepTangent::place(const BodyTwists& twists, int contact) const {
  const ContactPoint& p = record_->contacts[contact].before.point;
  return pose_of(p.point_body, twists.placements()).point(p.center_B);
}

Vec3 ContactStepTangent::place_change(int contact, const VecX& dq1) {
  const ContactPoint& p = record_->contacts[contact].before.point;
  twists1_.move(dq1);
  return pose_of(p.plane_body, twists1_.placements()).R.transpose() *
         relative(twists1_, contact, place(twists1_, contact));
}

void ContactStepTangent::set_start_rows(const VecX& dq0, double dt) {
  const ContactStepRecord& s = *record_;
  dW0_.setZero();
  down0_.setZero(rows_);
  if (constraints_ > 0) {
    start_constraints_.change(dq0, dt, dW0_.leftCols(constraints_));
    drate0_ = start_constraints_.rate_change(dq0, dt);
  }
  twists0_.move(dq0);
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const ContactStepRecord::Contact& c = s.contacts[i];
    const int r = c.row;
    start_[i].change(dq0, c.t1_start, dW0_.middleCols(r, c.before.rows()));
    dn0_[i] = start_[i].normal_change();
    dt1_[i] = -dn0_[i].dot(c.t1_start) * c.start.normal;
    if (start_surfaces_[i].moves())
      down0_.segment<2>(r + 1) = start_surfaces_[i].change(start_[i]) + dt * start_surfaces_[i].rate();
    if (c.before.mu == 0.0 || c.before.point.kind != PointKind::kVertex || start_[i].has_axis()) continue;
    const Vec3 t2 = c.start.normal.cross(c.t1_start);
    const double about = t2.dot(twists0_.turn(c.before.point.plane_body).cross(c.t1_start));
    dW0_.col(r + 1) += about * s.W0.col(r + 2);
    dW0_.col(r + 2) -= about * s.W0.col(r + 1);
    const Eigen::Vector2d& own = start_surfaces_[i].velocity();
    down0_.segment<2>(r + 1) += about * Eigen::Vector2d(own[1], -own[0]);
  }
}

// After set_start_rows.
void ContactStepTangent::set_end_rows(const VecX& dq1, double dt) {
  const ContactStepRecord& s = *record_;
  dW1_.setZero();
  down1_.setZero(rows_);
  if (constraints_ > 0) {
    end_constraints_.change(dq1, dt, dW1_.leftCols(constraints_));
    drate1_ = end_constraints_.rate_change(dq1, dt);
  }
  twists1_.move(dq1);
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const ContactStepRecord::Contact& c = s.contacts[i];
    const int r = c.row;
    end_[i].change(dq1, c.t1_end, dW1_.middleCols(r, c.before.rows()));
    if (end_surfaces_[i].moves())
      down1_.segment<2>(r + 1) = end_surfaces_[i].change(end_[i]) + dt * end_surfaces_[i].rate();
    if (c.before.mu == 0.0 || end_[i].has_axis()) continue;
    const Vec3 &n0 = c.start.normal, &n1 = c.end.normal, &t = c.t1_start, &dn0 = dn0_[i],
               &dn1 = end_[i].normal_change();
    Vec3 dt1;
    if (c.before.point.kind == PointKind::kVertex) {
      dt1 = twists1_.turn(c.before.point.plane_body).cross(c.t1_end);
    } else {
      // t1 = t - (t.n1) / (1 + n0.n1) (n0 + n1), the shortest turn.
      const double length = 1.0 + n0.dot(n1), share = t.dot(n1) / length;
      const double dshare = (dt1_[i].dot(n1) + t.dot(dn1) - share * (dn0.dot(n1) + n0.dot(dn1))) / length;
      dt1 = dt1_[i] - dshare * (n0 + n1) - share * (dn0 + dn1);
    }
    const double about = n1.cross(c.t1_end).dot(dt1);
    dW1_.col(r + 1) += about * s.W1.col(r + 2);
    dW1_.col(r + 2) -= about * s.W1.col(r + 1);
    const Eigen::Vector2d& own = end_surfaces_[i].velocity();
    down1_.segment<2>(r + 1) += about * Eigen::Vector2d(own[1], -own[0]);
  }
}

// The changes of the velocities of the rows over the step, as ContactStep::set_row_velocities has them; after
// set_end_rows, along dq1.
void ContactStepTangent::row_changes(const VecX& dq0, const VecX& dq1, const VecX& dv, const ContactStepDirection& d,
                                     VecX& dy) {
  const ContactStepRecord& s = *record_;
  dy.setZero(rows_);
  const bool shorter = s.h < s.nominal;
  const double part = shorter ? 1.0 - s.h / s.nominal : 0.0;
  if (constraints_ > 0) dy.head(constraints_) = constraint_changes(dq0, dq1, dv, d);
  for (std::size_t k = 0; k < s.joints.size(); ++k) {
    const ContactStepRecord::Joint& joint = s.joints[k];
    if (joint.by_place) {
      const double reference = !joint.anchored ? dq0[joint.dof] : d.joints.size() > 0 ? d.joints[k] : 0.0;
      dy[joint_row(k)] = (dq1[joint.dof] - reference) / s.h;
    } else {
      dy[joint_row(k)] = dv[joint.dof];
    }
  }
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const ContactStepRecord::Contact& c = s.contacts[i];
    const ContactPoint& point = c.before.point;
    const int r = c.row;
    const double dgap0 = s.W0.col(r).dot(dq0);
    if (c.by_rate) {
      dy[r] = 0.5 * ((dW0_.col(r) + dW1_.col(r)).dot(s.v) + (s.W0.col(r) + s.W1.col(r)).dot(dv)) + dgap0 / s.nominal;
    } else {
      const double value = (c.end.gap - part * c.start.gap) / s.h;
      dy[r] =
          (s.W1.col(r).dot(dq1) - part * dgap0 + (shorter ? d.h / s.nominal * c.start.gap : 0.0) - value * d.h) / s.h;
    }
    if (c.before.mu == 0.0) continue;
    if (!c.before.counts_by_place()) {
      for (int k = r + 1; k < r + 3; ++k)
        dy[k] =
            0.5 * ((dW0_.col(k) + dW1_.col(k)).dot(s.v) + (s.W0.col(k) + s.W1.col(k)).dot(dv) + down0_[k] + down1_[k]);
      continue;
    }
    const Vec3 moved = relative(twists1_, static_cast<int>(i), place(twists1_, static_cast<int>(i)));
    const Vec3 t2 = c.end.normal.cross(c.t1_end);
    const double sign = point.on_b ? 1.0 : -1.0;
    Vec3 reference = Vec3::Zero();  // world at the end
    const Mat3& R1 = pose_of(point.plane_body, twists1_.placements()).R;
    if (!c.before.anchored) {
      const Mat3& R0 = pose_of(point.plane_body, twists0_.placements()).R;
      reference = R1 * (R0.transpose() * relative(twists0_, static_cast<int>(i), place(twists0_, static_cast<int>(i))));
    } else if (d.anchors.size() > 0) {
      reference = R1 * d.anchors.col(i);
    }
    const Vec3 change = sign * (moved - reference);
    dy.segment<2>(r + 1) = (Eigen::Vector2d(change.dot(c.t1_end), change.dot(t2)) - d.h * c.outcome.slip) / s.h;
  }
}

// Those of the constraints, as ContactStep::set_constraint_velocities has them.
VecX ContactStepTangent::constraint_changes(const VecX& dq0, const VecX& dq1, const VecX& dv,
                                            const ContactStepDirection& d) const {
  const ContactStepRecord& s = *record_;
  const ConstraintTangent &start = start_constraints_, &end = end_constraints_;
  const auto of = [&](const MatX& W) { return W.leftCols(constraints_).transpose(); };
  const VecX dphi0 = of(s.W0) * dq0 + start.rates() * d.t;
  if (s.constraints_by_rate())
    return 0.5 * (of(dW0_ + dW1_) * s.v + of(s.W0 + s.W1) * dv) + 0.5 * (drate0_ + drate1_) + dphi0 / s.nominal;
  const bool shorter = s.h < s.nominal;
  const double part = shorter ? 1.0 - s.h / s.nominal : 0.0;
  const VecX dphi1 = of(s.W1) * dq1 + end.rates() * (d.t + d.h);
  const VecX value = (end.residuals() - part * start.residuals()) / s.h;
  return (dphi1 - part * dphi0 + (shorter ? d.h / s.nominal : 0.0) * start.residuals() - value * d.h) / s.h;
}

// Along which the friction of a contact acts. Where a slip begins with the end of the step its friction keeps the
// direction that it had at its limit.
Eigen::Vector2d ContactStepTangent::slip_of(const Problem& problem, std::size_t i) const {
  const ContactStepRecord::Contact& c = record_->contacts[i];
  if (problem.contacts[i] != Mode::kKept) return problem.w.segment<2>(c.row + 1);
  return directed_[i] ? c.outcome.slip : Eigen::Vector2d(-record_->lambda_end.segment<2>(c.row + 1));
}

// How that direction changes with the slip that it follows.
Eigen::Matrix2d ContactStepTangent::turn(const Problem& problem, std::size_t i) const {
  const bool keeps = problem.contacts[i] == Mode::kKept && !directed_[i];
  return keeps ? Eigen::Matrix2d(Eigen::Matrix2d::Zero()) : turn(slip_of(problem, i));
}

// What the slip over the step makes of the coefficient of friction along a slip of either problem.
Eigen::Matrix2d ContactStepTangent::friction_by_slip(const Eigen::Vector2d& slip, std::size_t i) const {
  if (mu_slope_[i] == 0.0) return Eigen::Matrix2d::Zero();
  return mu_slope_[i] * slip.normalized() * record_->contacts[i].outcome.slip.normalized().transpose();
}

// The equations for the changes of the impulses. rows: the effect of the impulses on the rows.
void ContactStepTangent::set_laws(Problem& problem, const MatX& rows) {
  const ContactStepRecord& s = *record_;
  MatX A = rows;
  for (std::size_t k = 0; k < s.joints.size(); ++k)
    if (problem.joints[k] == Mode::kKept) A.row(joint_row(k)) = MatX::Identity(rows_, rows_).row(joint_row(k));
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const ContactStepRecord::Contact& c = s.contacts[i];
    const int r = c.row, count = c.before.rows();
    const Mode mode = problem.contacts[i];
    if (mode == Mode::kOpen) A.middleRows(r, count) = MatX::Identity(rows_, rows_).middleRows(r, count);
    if (mode != Mode::kKept && mode != Mode::kSlip) continue;
    const Eigen::Vector2d slip = slip_of(problem, i);
    Eigen::Matrix2d by_slip = Eigen::Matrix2d::Zero();
    if (mode == Mode::kSlip) by_slip = problem.lambda[r] * mu_[i] * turn(slip);
    if (&problem == &position_) by_slip += problem.lambda[r] * friction_by_slip(slip, i);
    A.middleRows(r + 1, 2) = by_slip * rows.middleRows(r + 1, 2);
    A.block<2, 2>(r + 1, r + 1) += Eigen::Matrix2d::Identity();
    A.block<2, 1>(r + 1, r) += mu_[i] * slip.normalized();
  }
  problem.system.compute(A, constraints_);
}

// What the laws leave open must have no effect.
void ContactStepTangent::check_shared(const Problem& problem, const MatX& effect) const {
  const MatX& free = problem.system.free();
  if (free.cols() == 0 || !((effect * free).cwiseAbs().maxCoeff() > kShared * effect.cwiseAbs().maxCoeff())) return;
  const ContactStepRecord& s = *record_;
  if (s.contacts.empty())
    meet("redundant", -1, "The motion depends on how constraints share their load",
         "gradients of constraints that depend on each other, or clearly do not", "a nearly singular configuration",
         "Start elsewhere, or use fewer constraints");
  else
    meet("redundant", s.contacts[0].before.point.guard, "The motion depends on how contact points share their load",
         "a motion that the laws of contact determine", "points that turn while they slip",
         "Use fewer points (contact_points=3), or let bodies slip without turning");
}

// What the laws demand along a direction: base is the change of the rows with the impulses as they are, dy that of the
// slip over the step.
VecX ContactStepTangent::law_change(const Problem& problem, const ContactStepDirection& d, const VecX& base,
                                    const VecX& dy) const {
  const ContactStepRecord& s = *record_;
  VecX c = base;
  for (std::size_t k = 0; k < s.joints.size(); ++k)
    if (problem.joints[k] == Mode::kKept) c[joint_row(k)] = -problem.lambda[joint_row(k)] * d.h / s.h;
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const ContactStepRecord::Contact& contact = s.contacts[i];
    const int r = contact.row;
    const Mode mode = problem.contacts[i];
    if (mode == Mode::kOpen) c.segment(r, contact.before.rows()).setZero();
    if (mode != Mode::kKept && mode != Mode::kSlip) continue;
    const Eigen::Vector2d slip = slip_of(problem, i);
    const VecX& change = mode == Mode::kKept ? dy : base;
    const double dmu = d.mu.size() > 0 ? d.mu[i] : 0.0;
    c.segment<2>(r + 1) =
        problem.lambda[r] * (dmu * slip.normalized() + mu_[i] * turn(problem, i) * change.segment<2>(r + 1) +
                             friction_by_slip(slip, i) * dy.segment<2>(r + 1));
  }
  return c;
}

void ContactStepTangent::solve_laws(const Problem& problem, const VecX& c, const VecX& size, VecX& dlambda) const {
  if (problem.system.solve(c, size, dlambda)) return;
  meet("redundant", -1, "Contact points that share their load contradict each other along a direction",
       "a direction that keeps the points of a face closed together", "one that opens some of them",
       "Start with the bodies apart, or in touch at one point; on_kink='taken' keeps them closed");
}

// Whether the slip whose end ended the step goes on in the impulse at its end, ends beside others that go on, and was
// there over the step.
ContactStepTangent::EndedSlip ContactStepTangent::ended_slip() const {
  const ContactStepRecord& s = *record_;
  const auto count = static_cast<int>(s.contacts.size());
  if (s.ended >= count) {
    const ContactStepRecord::Joint& joint = s.joints[static_cast<std::size_t>(s.ended - count)];
    return {joint.keeps, joint.freed, joint.slipped};
  }
  const ContactOutcome& out = s.contacts[static_cast<std::size_t>(s.ended)].outcome;
  return {out.keeps, out.freed, out.slipped && !out.turned};
}

// The velocity impulse up to the end of the slip that ended the step: with the friction of all contacts that slipped
// going on. Where several slips end at one instant it is that of the order that was taken, a kink: those that ended
// first have ended. A slip that was at rest already when the step began has no time of its own.
void ContactStepTangent::take_released_friction() {
  const ContactStepRecord& s = *record_;
  const auto count = static_cast<int>(s.contacts.size());
  const int guard = s.ended < count ? s.contacts[s.ended].before.point.guard : -1;
  const EndedSlip slip = ended_slip();
  frozen_.joints = velocity_.joints;
  frozen_.contacts = velocity_.contacts;
  bool alone = slip.freed || slip.keeps;
  for (std::size_t k = 0; k < s.joints.size(); ++k) {
    const ContactStepRecord::Joint& joint = s.joints[k];
    alone &= slip.freed || !joint.freed;
    if (joint.slipped && (slip.freed || !joint.freed)) frozen_.joints[k] = Mode::kKept;
  }
  for (int i = 0; i < count; ++i) {
    const ContactOutcome& out = s.contacts[i].outcome;
    alone &= slip.freed || !out.freed;
    if (frozen_.contacts[i] == Mode::kOpen) continue;
    if (out.slipped && (slip.freed || !out.freed)) frozen_.contacts[i] = Mode::kKept;
    alone &= frozen_.contacts[i] != Mode::kSlip;
    // While the impulse is that of the step its slips turn as they do there.
    if (!slip.keeps && frozen_.contacts[i] == Mode::kSlip) frozen_.contacts[i] = Mode::kKept;
  }
  slip_ends_ = slip.lasts;
  if (!alone || !slip_ends_)
    meet("stick", guard, "Several slips come to rest at one instant", "one slip that comes to rest",
         "several at once, or one that turns",
         "Start elsewhere; on_kink='taken' gives the derivative of what was taken");
  if (!slip_ends_) return;
  if (slip.keeps) {
    frozen_ = velocity_;
    v_frozen_ = s.v1;
    return;
  }
  set_laws(frozen_, G_);
  check_shared(frozen_, MinvW_);
  VecX right = w_minus_;
  for (std::size_t k = 0; k < s.joints.size(); ++k)
    if (frozen_.joints[k] == Mode::kKept)
      right[joint_row(k)] = std::copysign(0.5 * s.h * s.joints[k].limit, -s.lambda[joint_row(k)]);
  for (int i = 0; i < count; ++i) {
    const ContactStepRecord::Contact& c = s.contacts[i];
    if (frozen_.contacts[i] == Mode::kOpen) right.segment(c.row, c.before.rows()).setZero();
    if (frozen_.contacts[i] == Mode::kKept) right.segment<2>(c.row + 1).setZero();
  }
  const VecX size = MinvW_.cwiseAbs().transpose() * s.p_minus.cwiseAbs();
  if (!frozen_.system.solve(right, size, frozen_.lambda))
    refuse("stick", guard, "A slip ends in a way whose time has no derivative that is known",
           "one slip that comes to rest", "contacts that contradict each other", "Start elsewhere");
  v_frozen_ = s.p_minus + s.W1 * frozen_.lambda;
  masses_.solve_mass(v_frozen_);
  frozen_.w.noalias() = s.W1.transpose() * v_frozen_;
  frozen_.w += own_end_;
}

// Of the velocity impulse and of the speeds of the rows at the end. v: the velocity there; dy: of the rows over the
// step.
void ContactStepTangent::end_change(const Problem& problem, const VecX& v, const ContactStepDirection& d,
                                    const VecX& dy, const VecX& dq1, const VecX& dp_minus, const VecX& size,
                                    VecX& dlambda, VecX& dw) {
  step_.momentum(record_->q1, v, dq1, none_, work_);
  if (d.parameters != nullptr) step_.add_momentum(record_->q1, v, *d.parameters, work_);
  work_ += record_->W1 * pull_change(1, d.t, d.h);
  VecX base = dW1_.transpose() * v + MinvW_.transpose() * (dp_minus + dW1_ * given(problem.lambda, 1) - work_) + down1_;
  if (constraints_ > 0) base.head(constraints_) += drate1_;
  solve_laws(problem, law_change(problem, d, base, dy), size, dlambda);
  dw = base + G_ * dlambda;
}

void ContactStepTangent::solve(const ContactStepDirection& d, VecRef dq1, VecRef dp1) {
  const ContactStepRecord& s = *record_;
  const VecX dq0 = d.q.size() > 0 ? d.q : none_;
  set_start_rows(dq0, d.t);
  StepDirection& direction = step_direction_;
  direction.q = dq0;
  direction.p = dW0_ * given(s.lambda, 0) - s.W0 * pull_change(0, d.t, d.h);
  if (d.p.size() > 0) direction.p += d.p;
  direction.t = d.t;
  direction.h = d.h;
  direction.tau = d.tau;
  direction.parameters = d.parameters;
  VecX q(scene_->tree.nv);
  if (!step_.solve(direction, q, dp_minus_))
    refuse("step", -1, "The derivative of a step was not solved", "tangent equations with a solution", "none",
           "Use a smaller dt");
  step_.velocity_change(0, dv_);
  set_end_rows(q, d.t + d.h);
  row_changes(dq0, q, dv_, d, base_);
  // The impulses of the contacts take away what is larger before.
  const double size_q = std::max({d.size_q, dq0.cwiseAbs().maxCoeff(), q.cwiseAbs().maxCoeff()});
  double size_p = std::max({d.size_p, direction.p.cwiseAbs().maxCoeff(), dp_minus_.cwiseAbs().maxCoeff()});
  const auto sizes = [&]() -> VecX {
    return (size_q / s.h * s.W1.cwiseAbs() + size_p * MinvW_.cwiseAbs()).colwise().sum();
  };
  solve_laws(position_, law_change(position_, d, base_, base_), sizes(), dlambda_);
  size_p = std::max(size_p, (P_.cwiseAbs() * dlambda_.cwiseAbs()).maxCoeff());
  q.noalias() += Q_ * dlambda_;
  dp_minus_.noalias() += P_ * dlambda_;
  dy_ = base_ + Y_ * dlambda_;
  set_end_rows(q, d.t + d.h);
  end_change(velocity_, s.v1, d, dy_, q, dp_minus_, sizes(), dlambda_end_, dw_);
  dp1 = dp_minus_ + dW1_ * given(s.lambda_end, 1) + s.W1 * (dlambda_end_ - pull_change(1, d.t, d.h));
  dq1 = q;
  if (!slip_ends_) return;
  end_change(frozen_, v_frozen_, d, dy_, q, dp_minus_, sizes(), dlambda_end_, dw_);
  const auto count = static_cast<int>(s.contacts.size());
  if (s.ended >= count) {
    slip_change_ = dw_[joint_row(s.ended - count)];
    return;
  }
  const ContactStepRecord::Contact& contact = s.contacts[s.ended];
  const int r = contact.row;
  slip_change_ = contact.outcome.slip.normalized().dot(dw_.segment<2>(r + 1)) +
                 (turn(contact.outcome.slip) * dy_.segment<2>(r + 1)).dot(frozen_.w.segment<2>(r + 1));
}

// Of the discrete energy.
double ContactStepTangent::energy_change() {
  StepDirection direction = step_direction_;
  direction.p += record_->W0 * dlambda_;
  VecX q(scene_->tree.nv), p(scene_->tree.nv);
  if (!step_.solve(direction, q, p)) throw Error("the derivative of a step was not solved");
  return step_.energy_change();
}

double ContactStepTangent::energy_change_after() {
  double change = energy_change();
  if (constraints_ == 0) return change;
  change += dlambda_.head(constraints_).dot(start_constraints_.rates());
  return change + record_->lambda.head(constraints_).dot(drate0_);
}

double ContactStepTangent::energy_change_before() {
  double change = energy_change();
  if (constraints_ == 0) return change;
  change -= dlambda_end_.head(constraints_).dot(end_constraints_.rates());
  return change - record_->lambda_end.head(constraints_).dot(drate1_);
}

}  // namespace contactvi

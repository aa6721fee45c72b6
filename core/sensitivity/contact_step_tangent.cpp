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
  if (step.lacks_laws)
    for (const auto& c : step.contacts) require_plain_law(*scene_, c.before.point.guard, step.t);
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
  velocity_.open.clear();
  velocity_.frictions.clear();
  for (std::size_t k = 0; k < step.joints.size(); ++k) {
    const ContactStepRecord::Joint& joint = step.joints[k];
    velocity_.joints.push_back(joint.keeps || joint.slips ? Mode::kKept : Mode::kStick);
  }
  for (const ContactStepRecord::Contact& c : step.contacts)
    velocity_.open.push_back(!c.outcome.active || !(step.lambda_end[c.row] > 0.0));
  const ContactStepRecord::Contact* limited = nullptr;
  for (const Friction& f : frictions_) {
    Mode mode = Mode::kStick;
    if (velocity_.open[f.contact]) {
      mode = Mode::kOpen;
    } else if (f.keeps) {
      mode = Mode::kKept;
    } else if (f.slips) {
      const bool follows = follows_slip(f, f.end.mu, step.lambda_end, velocity_.w.segment(f.rows.row, f.rows.count));
      if (follows) mode = Mode::kSlip;
      // What ended the step is at its limit there.
      const bool ends = step.ending == ContactStepEnd::kStick && ended_joint() < 0 && &ended_friction() == &f;
      if (!follows && !ends) limited = &step.contacts[f.contact];
    }
    velocity_.frictions.push_back(mode);
  }
  if (limited != nullptr) meet_limit_of_friction(limited->before.point.guard);
  check_laws();
  set_laws(velocity_, G_);
  check_shared(velocity_, MinvW_);
  if (step.ending == ContactStepEnd::kStick) take_released_friction();
}

// Whether the friction of a contact in either problem is against its slip. Of a slip that is as small as what the step
// leaves of its equations it may not be: then the contact is at the limit of its friction, and sticks.
bool ContactStepTangent::follows_slip(const Friction& f, double mu, const VecX& lambda, const VecX& slip) const {
  if (slip.norm() > kLaw * (1.0 + record_->v.cwiseAbs().maxCoeff())) return true;
  const double limit = mu * lambda[f.normal];
  return (lambda.segment(f.rows.row, f.rows.count) + limit * slip.normalized()).norm() <= kLaw * limit;
}

// Of the slip and the friction of a contact, with a normal impulse over half of the step.
ContactStepTangent::Coefficient ContactStepTangent::coefficient(const Friction& f, double normal_impulse) const {
  const ContactStepRecord& s = *record_;
  const PersistentContact& before = s.contacts[f.contact].before;
  if (f.rows.rolls) return {};
  if (!scene_->friction_varies(before.point.guard)) return {before.mu};
  const double speed = f.slip.head<2>().norm();
  std::vector<FrictionState> one{
      {before.point.guard, before.sticks, speed, 2.0 * normal_impulse / s.h, s.t + 0.5 * s.h, before.mu}};
  set_friction(*scene_, one, true);
  const FrictionState& found = one.front();
  return {found.mu, speed > 0.0 ? found.by_slip : 0.0, found.by_normal, found.by_time};
}

// Of a contact with friction.
void ContactStepTangent::add_friction(std::size_t i) {
  const ContactStepRecord::Contact& c = record_->contacts[i];
  const ContactOutcome& out = c.outcome;
  for (const FrictionRows& rows : friction_rows(c.row, c.before.rows())) {
    Friction f{i, rows, c.row, {}, {}, {}, VecX(rows.count), false, false, false, false, false, false};
    if (rows.rolls) {
      f.slip = out.turning_slip.tail<2>();
      f.slipped = out.rolled;
      f.slips = out.rolls;
      f.keeps = out.roll_keeps;
      f.freed = out.roll_freed;
      f.turned = out.roll_turned;
    } else {
      f.slip.head<2>() = out.slip;
      if (rows.count == 3) f.slip[2] = out.turning_slip[0];
      f.slipped = out.slipped;
      f.slips = out.slips;
      f.keeps = out.keeps;
      f.freed = out.freed;
      f.turned = out.turned;
    }
    f.start = coefficient(f, record_->lambda[c.row]);
    f.end = f.frozen = coefficient(f, record_->lambda_end[c.row]);
    frictions_.push_back(std::move(f));
  }
}

void ContactStepTangent::meet_limit_of_friction(int guard) const {
  meet("friction", guard, "A persistent contact changes between sticking and slipping",
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
  frictions_.clear();
  own_end_.setZero(rows_);
  position_.lambda = s.lambda;
  position_.w.setZero(rows_);
  dn0_.assign(n, Vec3::Zero());
  dt1_.assign(n, Vec3::Zero());
  position_.open.clear();
  position_.frictions.clear();
  position_.joints.clear();
  for (std::size_t k = 0; k < s.joints.size(); ++k) {
    const double bound = 0.5 * s.h * s.joints[k].limit, friction = std::abs(s.lambda[joint_row(k)]);
    const bool at_bound = friction >= bound * (1.0 - kOnCone);
    if (bound > 0.0 && !s.joints[k].slipped) margin_ = std::min(margin_, 1.0 - friction / bound);
    position_.joints.push_back(at_bound ? Mode::kKept : Mode::kStick);
  }
  // A slip that comes to rest in a short step is as short as that.
  const double speed = s.v.cwiseAbs().maxCoeff() * std::min(1.0, s.h / s.nominal);
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
    position_.open.push_back(!(s.lambda[c.row] > 0.0));
    if (c.before.mu == 0.0) continue;
    add_friction(i);
    const int count = c.before.rows() - 1;
    start_surfaces_[i].take(*scene_, guard, start_[i], c.t1_start, s.t);
    end_surfaces_[i].take(*scene_, guard, end_[i], c.t1_end, s.t + s.h);
    own_end_.segment(c.row + 1, count) = end_surfaces_[i].velocity();
  }
  int at_limit = -1;  // the guard with the least margin; -1: a joint
  for (Friction& f : frictions_) {
    const double before = margin_, normal = s.lambda[f.normal];
    if (position_.open[f.contact]) {
      position_.frictions.push_back(Mode::kOpen);
      continue;
    }
    const double limit = f.start.mu * normal, friction = s.lambda.segment(f.rows.row, f.rows.count).norm();
    f.directed = f.slipped && follows_slip(f, f.start.mu, s.lambda, f.slip);
    position_.frictions.push_back(f.directed ? Mode::kSlip : Mode::kStick);
    if (f.slipped && !f.directed) margin_ = 0.0;
    position_.w.segment(f.rows.row, f.rows.count) = f.slip;
    margin_ = std::min(margin_, f.slipped ? f.slip.norm() / (speed + 1e-300) : (limit - friction) / largest);
    if (margin_ < before) at_limit = s.contacts[f.contact].before.point.guard;
  }
  if (margin_ < kOnCone) meet_limit_of_friction(at_limit);
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
      const double rate = adhesion_rate(*scene_, c.before, t);
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
  const auto check = [&](int guard, double off_impulse, double off_speed) {
    if (off_impulse > kLaw * impulse || off_speed > kLaw * speed)
      refuse("contact", guard, "The impulses of a persistent contact do not satisfy one law of friction",
             "a contact that is open, sticks or slips", "something in between", "Use a smaller dt");
  };
  for (std::size_t i = 0; i < s.contacts.size(); ++i)
    if (!velocity_.open[i]) check(s.contacts[i].before.point.guard, 0.0, std::abs(velocity_.w[s.contacts[i].row]));
  for (std::size_t k = 0; k < frictions_.size(); ++k) {
    const Friction& f = frictions_[k];
    const auto& [row, count, rolls] = f.rows;
    const VecX friction = s.lambda.segment(row, count), end = s.lambda_end.segment(row, count);
    double off_impulse = 0.0, off_speed = 0.0;
    if (position_.frictions[k] == Mode::kSlip)
      off_impulse = (friction + f.start.mu * s.lambda[f.normal] * f.slip.normalized()).norm();
    const Mode mode = velocity_.frictions[k];
    if (mode == Mode::kKept || mode == Mode::kSlip) {
      const VecX off = end + f.end.mu * s.lambda_end[f.normal] * slip_of(velocity_, k).normalized();
      off_impulse = std::max(off_impulse, off.norm());
    } else if (mode == Mode::kStick) {
      off_speed = velocity_.w.segment(row, count).norm();
      margin_ = std::min(margin_, std::abs(f.end.mu * s.lambda_end[f.normal] - end.norm()) / impulse);
    }
    check(s.contacts[f.contact].before.point.guard, off_impulse, off_speed);
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

// What the rows W of the friction of a contact, and the velocities of its surfaces in them, change by where its
// tangents turn about the normal.
void ContactStepTangent::turn_tangents(const ContactStepRecord::Contact& c, double about, const MatX& W,
                                       const VecX& own, MatX& dW, VecX& down) const {
  for (const FrictionRows& rows : friction_rows(c.row, c.before.rows())) {
    const int r = rows.row, k = r - c.row - 1;
    dW.col(r) += about * W.col(r + 1);
    dW.col(r + 1) -= about * W.col(r);
    down.segment<2>(r) += about * Eigen::Vector2d(own[k + 1], -own[k]);
  }
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
      down0_.segment(r + 1, c.before.rows() - 1) =
          start_surfaces_[i].change(start_[i]) + dt * start_surfaces_[i].rate();
    if (c.before.mu == 0.0 || c.before.point.kind != PointKind::kVertex || start_[i].has_axis()) continue;
    const Vec3 t2 = c.start.normal.cross(c.t1_start);
    const double about = t2.dot(twists0_.turn(c.before.point.plane_body).cross(c.t1_start));
    turn_tangents(c, about, s.W0, start_surfaces_[i].velocity(), dW0_, down0_);
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
      down1_.segment(r + 1, c.before.rows() - 1) = end_surfaces_[i].change(end_[i]) + dt * end_surfaces_[i].rate();
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
    turn_tangents(c, n1.cross(c.t1_end).dot(dt1), s.W1, end_surfaces_[i].velocity(), dW1_, down1_);
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
    const bool by_place = c.before.counts_by_place();
    for (int k = by_place ? r + 3 : r + 1; k < r + c.before.rows(); ++k)
      dy[k] =
          0.5 * ((dW0_.col(k) + dW1_.col(k)).dot(s.v) + (s.W0.col(k) + s.W1.col(k)).dot(dv) + down0_[k] + down1_[k]);
    if (!by_place) continue;
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
VecX ContactStepTangent::slip_of(const Problem& problem, std::size_t k) const {
  const Friction& f = frictions_[k];
  const auto& [row, count, rolls] = f.rows;
  if (problem.frictions[k] != Mode::kKept) return problem.w.segment(row, count);
  return f.directed ? f.slip : VecX(-record_->lambda_end.segment(row, count));
}

// How that direction changes with the slip that it follows.
MatX ContactStepTangent::turn(const Problem& problem, std::size_t k) const {
  const bool keeps = problem.frictions[k] == Mode::kKept && !frictions_[k].directed;
  const int count = frictions_[k].rows.count;
  return keeps ? MatX(MatX::Zero(count, count)) : turn_of(slip_of(problem, k));
}

// What the slip over the step makes of the coefficient of friction along a slip of either problem.
MatX ContactStepTangent::friction_by_slip(const Problem& problem, const VecX& slip, const Friction& f) const {
  const double slope = of(problem, f).by_slip;
  if (slope == 0.0) return MatX::Zero(slip.size(), slip.size());
  return slope * slip.normalized() * f.slip.normalized().transpose();
}

// The equations for the changes of the impulses. rows: the effect of the impulses on the rows.
void ContactStepTangent::set_laws(Problem& problem, const MatX& rows) {
  const ContactStepRecord& s = *record_;
  MatX A = rows;
  for (std::size_t k = 0; k < s.joints.size(); ++k)
    if (problem.joints[k] == Mode::kKept) A.row(joint_row(k)) = MatX::Identity(rows_, rows_).row(joint_row(k));
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const int r = s.contacts[i].row, count = s.contacts[i].before.rows();
    if (problem.open[i]) A.middleRows(r, count) = MatX::Identity(rows_, rows_).middleRows(r, count);
  }
  for (std::size_t k = 0; k < frictions_.size(); ++k) {
    const Friction& f = frictions_[k];
    const auto& [row, count, rolls] = f.rows;
    const Mode mode = problem.frictions[k];
    if (mode != Mode::kKept && mode != Mode::kSlip) continue;
    const VecX slip = slip_of(problem, k);
    const Coefficient& c = of(problem, f);
    MatX by_slip = MatX::Zero(count, count);
    if (mode == Mode::kSlip) by_slip = problem.lambda[f.normal] * c.mu * turn_of(slip);
    if (&problem == &position_) by_slip += problem.lambda[f.normal] * friction_by_slip(problem, slip, f);
    A.middleRows(row, count) = by_slip * rows.middleRows(row, count);
    A.block(row, row, count, count).diagonal().array() += 1.0;
    const double mu = c.by_normal == 0.0 ? c.mu : c.mu + c.by_normal * force_of(problem, f);
    A.block(row, f.normal, count, 1) += mu * slip.normalized();
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
  for (std::size_t i = 0; i < s.contacts.size(); ++i)
    if (problem.open[i]) c.segment(s.contacts[i].row, s.contacts[i].before.rows()).setZero();
  for (std::size_t k = 0; k < frictions_.size(); ++k) {
    const Friction& f = frictions_[k];
    const auto& [row, count, rolls] = f.rows;
    const Mode mode = problem.frictions[k];
    if (mode != Mode::kKept && mode != Mode::kSlip) continue;
    const VecX slip = slip_of(problem, k);
    const VecX& change = mode == Mode::kKept ? dy : base;
    const Coefficient& own = of(problem, f);
    double dmu = d.mu.size() > 0 && !rolls ? d.mu[static_cast<Eigen::Index>(f.contact)] : 0.0;
    dmu += own.by_time * (d.t + 0.5 * d.h);
    if (own.by_normal != 0.0) dmu -= own.by_normal * force_of(problem, f) * d.h / s.h;
    c.segment(row, count) =
        problem.lambda[f.normal] * (dmu * slip.normalized() + own.mu * turn(problem, k) * change.segment(row, count) +
                                    friction_by_slip(problem, slip, f) * dy.segment(row, count));
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
  if (const int joint = ended_joint(); joint >= 0) {
    const ContactStepRecord::Joint& of = s.joints[static_cast<std::size_t>(joint)];
    return {of.keeps, of.freed, of.slipped};
  }
  const Friction& f = ended_friction();
  return {f.keeps, f.freed, f.slipped && !f.turned};
}

// What ended the step counts after the contacts: joints, then the rolling of contacts.
int ContactStepTangent::ended_joint() const {
  const int joint = record_->ended - static_cast<int>(record_->contacts.size());
  return joint < static_cast<int>(record_->joints.size()) ? joint : -1;
}

const ContactStepTangent::Friction& ContactStepTangent::ended_friction() const {
  const ContactStepRecord& s = *record_;
  const std::size_t ended = static_cast<std::size_t>(s.ended), others = s.contacts.size() + s.joints.size();
  const bool rolls = ended >= others;
  for (const Friction& f : frictions_)
    if (f.rows.rolls == rolls && f.contact == (rolls ? ended - others : ended)) return f;
  throw Error("a contact step ended with a slip that no contact has");
}

// The velocity impulse up to the end of the slip that ended the step: with the friction of all contacts that slipped
// going on. Where several slips end at one instant it is that of the order that was taken, a kink: those that ended
// first have ended. A slip that was at rest already when the step began has no time of its own.
void ContactStepTangent::take_released_friction() {
  const ContactStepRecord& s = *record_;
  const int guard = ended_joint() >= 0 ? -1 : s.contacts[ended_friction().contact].before.point.guard;
  const EndedSlip slip = ended_slip();
  frozen_.joints = velocity_.joints;
  frozen_.open = velocity_.open;
  frozen_.frictions = velocity_.frictions;
  bool alone = slip.freed || slip.keeps;
  for (std::size_t k = 0; k < s.joints.size(); ++k) {
    const ContactStepRecord::Joint& joint = s.joints[k];
    alone &= slip.freed || !joint.freed;
    if (joint.slipped && (slip.freed || !joint.freed)) frozen_.joints[k] = Mode::kKept;
  }
  for (std::size_t k = 0; k < frictions_.size(); ++k) {
    const Friction& f = frictions_[k];
    alone &= slip.freed || !f.freed;
    Mode& mode = frozen_.frictions[k];
    if (mode == Mode::kOpen) continue;
    if (f.slipped && (slip.freed || !f.freed)) mode = Mode::kKept;
    alone &= mode != Mode::kSlip;
    // While the impulse is that of the step its slips turn as they do there.
    if (!slip.keeps && mode == Mode::kSlip) mode = Mode::kKept;
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
  frozen_.lambda = s.lambda_end;
  VecX right = w_minus_;
  for (std::size_t k = 0; k < s.joints.size(); ++k)
    if (frozen_.joints[k] == Mode::kKept)
      right[joint_row(k)] = std::copysign(0.5 * s.h * s.joints[k].limit, -s.lambda[joint_row(k)]);
  for (std::size_t i = 0; i < s.contacts.size(); ++i)
    if (frozen_.open[i]) right.segment(s.contacts[i].row, s.contacts[i].before.rows()).setZero();
  for (std::size_t k = 0; k < frictions_.size(); ++k)
    if (frozen_.frictions[k] == Mode::kKept) right.segment(frictions_[k].rows.row, frictions_[k].rows.count).setZero();
  const VecX size = MinvW_.cwiseAbs().transpose() * s.p_minus.cwiseAbs();
  FrictionRounds rounds;
  do {
    for (Friction& f : frictions_) f.frozen.by_normal = 0.0;  // these are equations for the impulses themselves
    set_laws(frozen_, G_);
    if (!frozen_.system.solve(right, size, frozen_.lambda))
      refuse("stick", guard, "A slip ends in a way whose time has no derivative that is known",
             "one slip that comes to rest", "contacts that contradict each other", "Start elsewhere");
  } while (rounds.go_on(follow_frozen_forces()));
  if (!rounds.settled())
    refuse("stick", guard, "A slip ends in a way whose time has no derivative that is known",
           "one slip that comes to rest", "friction that is not found with its normal force", "Start elsewhere");
  set_laws(frozen_, G_);
  check_shared(frozen_, MinvW_);
  v_frozen_ = s.p_minus + s.W1 * frozen_.lambda;
  masses_.solve_mass(v_frozen_);
  frozen_.w.noalias() = s.W1.transpose() * v_frozen_;
  frozen_.w += own_end_;
}

// By how much of themselves coefficients of friction change with the impulses that were found with them.
double ContactStepTangent::follow_frozen_forces() {
  double change = 0.0;
  for (Friction& f : frictions_) {
    if (!scene_->friction_by_state(record_->contacts[f.contact].before.point.guard)) continue;
    const Coefficient next = coefficient(f, frozen_.lambda[f.normal]);
    change = FrictionRounds::larger(change, next.mu, f.frozen.mu);
    f.frozen = next;
  }
  return change;
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
  if (const int joint = ended_joint(); joint >= 0) {
    slip_change_ = dw_[joint_row(static_cast<std::size_t>(joint))];
    return;
  }
  const Friction& f = ended_friction();
  const auto& [row, count, rolls] = f.rows;
  slip_change_ = f.slip.normalized().dot(dw_.segment(row, count)) +
                 (turn_of(f.slip) * dy_.segment(row, count)).dot(frozen_.w.segment(row, count));
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

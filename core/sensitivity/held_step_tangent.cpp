#include "sensitivity/held_step_tangent.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {
constexpr double kShared = 1e-7;  // of the effect of all impulses: what is shared has less
constexpr int kPasses = 3;        // the first solves, the others take the rounding off
constexpr double kStill = 1e-11;  // of the speeds: slip below it has no direction
// Of the terms of a speed: what changes by more along a direction is moved by it.
constexpr double kMoved = 1e-8;
constexpr double kVacuous = 1e-12;  // of the largest mobility: an equation with less says nothing
constexpr double kAcross = 1e-6;    // of the speeds: a slip that is across its direction by more has turned back
const ContactStepDirection kNoDirection;
}  // namespace

HeldStepTangent::HeldStepTangent(const Scene& scene, int stages, int contact_points, bool take_branch)
    : scene_(&scene),
      tree_(&scene.tree),
      nv_(scene.tree.nv),
      stages_(stages),
      take_branch_(take_branch),
      fixed_(scene.tree.elements.constraint_rows),
      table_(&lobatto_table(stages)),
      raised_(stages),
      step_(scene.tree, stages),
      masses_(scene.tree, 1, 1e-12, 1),
      guards_(scene, contact_points),
      phase_(guards_, scene.tree.nv),
      at_stage_(scene),
      nodes_(static_cast<std::size_t>(stages) + 1, HeldNode(scene)),
      charts_(static_cast<std::size_t>(stages), NodeChart(scene.tree)),
      weights_(stages, stages),
      to_nodes_(stages, stages + 1),
      velocities_(scene.tree.nv, stages),
      slip_start_(scene),
      raised_charts_(static_cast<std::size_t>(stages), NodeChart(scene.tree)),
      none_(VecX::Zero(scene.tree.nv)) {}

void HeldStepTangent::refuse(const char* reason, int guard, const char* fact, const char* expected,
                             const std::string& got, const char* remedy) const {
  throw NoDerivative({reason, guard, record_->t}, fact, expected, got, remedy);
}

void HeldStepTangent::refuse_unsolved() const {
  refuse("step", -1, "The derivative of a step was not solved", "tangent equations with a solution", "none",
         "Use a smaller dt");
}

int HeldStepTangent::first_guard() const {
  return record_->contacts.empty() ? -1 : record_->contacts.front().point.guard;
}

VecX HeldStepTangent::of_node(const VecX& x, int node, const VecX& start) const {
  VecX found(rows_ + slides_);
  found.head(fixed_) = x.segment(stage_unknowns() + node * fixed_, fixed_);
  found.segment(fixed_, held()) = x.segment(stage_unknowns() + stages_ * fixed_ + node * held(), held());
  found.tail(slides_) = node == 0 ? start : VecX(x.segment(turns_at(node), slides_));
  return found;
}

void HeldStepTangent::set_node(VecRef x, int node, const VecX& values) const {
  x.segment(stage_unknowns() + node * fixed_, fixed_) = values.head(fixed_);
  x.segment(stage_unknowns() + stages_ * fixed_ + node * held(), held()) = values.tail(held());
}

void HeldStepTangent::take(const HeldStepRecord& step, const VecX& tau, const Servo* servo) {
  record_ = &step;
  const GaussTable& gauss = gauss_table(stages_);
  for (int j = 0; j < stages_; ++j) {
    for (int i = 0; i < stages_; ++i) weights_(j, i) = step.h * gauss.A[i][j];
    for (int k = 0; k <= stages_; ++k) to_nodes_(j, k) = step.h * table_->to_node[k][j];
  }
  place_nodes();
  give_impulses();
  step_.take(step.q0, p_start_, step.h, tau, step.t, servo, velocities_);
  step_.add_impulses(impulses_);
  if (slides_ > 0 || !record_->joints.empty()) take_start(tau, servo);
  take_end();
  if (slides_ > 0) take_slips();
  make_matrix();
}

void HeldStepTangent::place_nodes() {
  const HeldStepRecord& s = *record_;
  const MatX X = s.rates * weights_, X_nodes = s.rates * to_nodes_;
  for (int i = 0; i < stages_; ++i) {
    NodeChart& chart = charts_[static_cast<std::size_t>(i)];
    chart.take(X.col(i));
    velocities_.col(i) = chart.velocity(s.rates.col(i));
  }
  phase_.set(s.contacts, s.joints, 2 * stages_ + 1);
  rows_ = fixed_ + phase_.count();
  slides_ = static_cast<int>(phase_.slides().size());
  load_ = phase_.load() != nullptr ? *phase_.load() : none_;
  rolling_.clear();
  for (int r = 0; r < phase_.count(); ++r)
    if (phase_.by_rate(r)) rolling_.push_back(fixed_ + r);
  slide_of_.clear();
  for (std::size_t i = 0; i < s.contacts.size(); ++i)
    if (phase_.slide(i) >= 0) slide_of_.push_back(i);
  VecX q(tree_->nq);
  const auto place = [&](HeldNode& node, double part, const VecX& X_node, const VecX& lambda, const VecX& angles,
                         double weight, int number) {
    integrate(*tree_, s.q0, X_node, 1.0, q);
    if (node.take(q, s.t + part * s.h, X_node, lambda, angles, weight * load_, s, phase_, number)) return;
    refuse("witness", node.refused(), "The gap of a persistent contact has no second derivative",
           "one pair of nearest points", node.why(), "Start elsewhere, or round the edges of the shapes");
  };
  const VecX forward = VecX::Zero(slides_);
  for (int k = 0; k <= stages_; ++k)
    place(nodes_[static_cast<std::size_t>(k)], table_->d[k], X_nodes.col(k), s.lambda.col(k),
          slides_ > 0 ? VecX(s.angles.col(k)) : forward, s.h * table_->e[k], k);
  roll_W_.clear();
  roll_change_.clear();
  MatX watched, along;
  for (int i = 0; i < stages_ && !rolling_.empty(); ++i) {
    place(at_stage_, gauss_table(stages_).c[i], X.col(i), VecX::Zero(rows_), forward, 0.0, stages_ + 1 + i);
    roll_W_.push_back(at_stage_.gradients()(Eigen::all, rolling_));
    at_stage_.change_speeds(velocities_.col(i), watched, along);
    roll_change_.push_back(watched(rolling_, Eigen::all));
  }
}

// As StageConstraints has them.
void HeldStepTangent::give_impulses() {
  p_start_ = record_->p0;
  impulses_.setZero(nv_, stages_);
  for (int k = 0; k < stages_; ++k) {
    const HeldNode& node = nodes_[static_cast<std::size_t>(k)];
    p_start_ += node.chart().at_start(node.force());
    const VecX given = node.chart().by_chart(node.force());
    for (int i = 0; i < stages_; ++i) impulses_.col(i) += (table_->share[i][k] - 1.0) * given;
  }
}

void HeldStepTangent::take_start(const VecX& tau, const Servo* servo) {
  const HeldStepRecord& s = *record_;
  HeldNode& start = nodes_.front();
  masses_.place_node(s.q0);
  inverse_start_.setIdentity(nv_, nv_);
  masses_.solve_masses(inverse_start_);
  v0_ = inverse_start_ * s.p0;
  start_mass_change_.resize(nv_, nv_);
  for (int k = 0; k < nv_; ++k) step_.momentum(s.q0, v0_, VecX::Unit(nv_, k), none_, start_mass_change_.col(k));
  start.change_speeds(v0_, start_watched_, start_along_);
  start_slips_ = start.along().transpose() * v0_;
  std::vector<int> begins;
  const double still = kStill * (1.0 + v0_.cwiseAbs().maxCoeff());
  for (int j = 0; j < slides_; ++j)
    if (std::abs(start_slips_[j]) <= still) begins.push_back(j);
  if (slip_start_.take(s, phase_, std::move(begins), tau, servo)) return;
  refuse("witness", first_guard(), "The direction in which a slip begins has no derivative",
         "nearest points inside of their features", "points near their ends", "Start elsewhere");
}

void HeldStepTangent::take_end() {
  const HeldStepRecord& s = *record_;
  HeldNode& end = nodes_.back();
  masses_.place_node(end.configuration());
  MinvF_ = end.given();
  MinvC_ = end.watched();
  masses_.solve_masses(MinvF_);
  masses_.solve_masses(MinvC_);
  end_mass_change_.resize(nv_, nv_);
  for (int k = 0; k < nv_; ++k)
    step_.momentum(end.configuration(), s.v1, VecX::Unit(nv_, k), none_, end_mass_change_.col(k));
  end.change_speeds(s.v1, end_watched_, end_along_);
  MatX A = end.watched().transpose() * MinvF_;
  A.bottomRightCorner(slides_, slides_).diagonal() -= end.along().transpose() * s.v1;
  // What can neither move across its slip nor slips any more has no direction there.
  undirected_.clear();
  const double zero = slides_ > 0 ? kVacuous * A.diagonal().head(rows_).maxCoeff() : 0.0;
  for (int r = rows_; r < rows_ + slides_; ++r) {
    if (A.row(r).cwiseAbs().maxCoeff() > zero) continue;
    A.row(r) = VecX::Unit(rows_ + slides_, r).transpose();
    undirected_.push_back(r);
  }
  end_system_.compute(std::move(A), fixed_, slides_);
  if (s.ending == HeldStepEnd::kRest) {
    take_rests();
  } else {
    rest_speeds_.resize(nv_, 0);
    MinvR_.resize(nv_, 0);
    rest_changes_.resize(0, nv_);
  }
}

// What comes to rest at the end: first what ended the step, then what does so with it.
void HeldStepTangent::take_rests() {
  const HeldStepRecord& s = *record_;
  const HeldNode& end = nodes_.back();
  const auto contacts = static_cast<int>(s.contacts.size()), all = contacts + static_cast<int>(s.joints.size());
  const double still = kStill * (1.0 + s.v1.cwiseAbs().maxCoeff());
  std::vector<VecX> speeds, changes;
  const auto add = [&](int number, bool checked) {
    VecX speed = none_, change = none_;
    if (number >= contacts) {
      const FrictionJoint& joint = s.joints[static_cast<std::size_t>(number - contacts)];
      if (joint.sticks) return;
      speed[joint.dof] = joint.heading;
    } else {
      const int j = phase_.slide(static_cast<std::size_t>(number));
      if (j < 0) return;
      speed = end.along().col(j);
      change = end_along_.row(j).transpose();
    }
    if (checked && !(std::abs(speed.dot(s.v1)) <= still)) return;
    speeds.push_back(std::move(speed));
    changes.push_back(std::move(change));
  };
  add(s.ended, false);
  for (int number = 0; number < all; ++number)
    if (number != s.ended) add(number, true);
  const auto count = static_cast<Eigen::Index>(speeds.size());
  rest_speeds_.resize(nv_, count);
  rest_changes_.resize(count, nv_);
  for (Eigen::Index k = 0; k < count; ++k) {
    rest_speeds_.col(k) = speeds[static_cast<std::size_t>(k)];
    rest_changes_.row(k) = changes[static_cast<std::size_t>(k)].transpose();
  }
  MinvR_ = rest_speeds_;
  masses_.solve_masses(MinvR_);
}

// The slips at the nodes between both ends.
void HeldStepTangent::take_slips() {
  const HeldStepRecord& s = *record_;
  end_rate_ = nodes_.back().chart().rate(s.v1);
  raised_rates_ =
      s.rates * raised_.rate + v0_ * raised_.rate_by_start.transpose() + end_rate_ * raised_.rate_by_end.transpose();
  raised_X_ = s.h * (s.rates * raised_.moved + v0_ * raised_.moved_by_start.transpose() +
                     end_rate_ * raised_.moved_by_end.transpose());
  node_watched_.resize(static_cast<std::size_t>(stages_));
  node_slips_.setZero(slides_, stages_);
  MatX along;
  const double speed = 1.0 + s.v1.cwiseAbs().maxCoeff();
  for (int k = 1; k < stages_; ++k) {
    HeldNode& node = nodes_[static_cast<std::size_t>(k)];
    NodeChart& chart = raised_charts_[static_cast<std::size_t>(k - 1)];
    chart.take(raised_X_.col(k - 1));
    const VecX v = chart.velocity(raised_rates_.col(k - 1));
    node.change_speeds(v, node_watched_[static_cast<std::size_t>(k - 1)], along);
    node_slips_.col(k - 1) = node.along().transpose() * v;
    const VecX across = node.watched().rightCols(slides_).transpose() * v;
    if (across.cwiseAbs().maxCoeff() <= kAcross * speed) continue;
    refuse("friction", first_guard(), "A slip turns back within a step", "slips that go on to the end of the step",
           "one that does not", "Use a smaller dt");
  }
}

PhaseEnd HeldStepTangent::phase_end(double nominal) {
  const HeldStepRecord& s = *record_;
  const VecX& q1 = nodes_.back().configuration();
  VecX p1(nv_), force(nv_);
  masses_.dynamics(q1, s.v1, p1, force);
  PhaseEnd end{s.t + s.h, nominal, q1, p1, s.v1, fixed_, {}, {}, s.ended, s.ending == HeldStepEnd::kRelease};
  for (const FrictionJoint& joint : s.joints) end.joints.push_back({joint.dof, joint.limit});
  end.rows += static_cast<int>(s.joints.size());
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const PersistentRows::Site& site = phase_.site(stages_, i);
    end.contacts.push_back({s.contacts[i], site.t1, site.contact.normal, s.contacts[i].slides(), end.rows});
    end.rows += s.contacts[i].rows();
  }
  masses_.place_node(q1);
  return end;
}

VecX HeldStepTangent::friction_changes(const ContactStepDirection& d) const {
  VecX found = VecX::Zero(slides_);
  for (int j = 0; j < slides_ && d.mu.size() > 0; ++j)
    found[j] = d.mu[static_cast<Eigen::Index>(slide_of_[static_cast<std::size_t>(j)])];
  return found;
}

// Of the force at a node, where the configuration there moves along dq and impulses and directions change.
VecX HeldStepTangent::force_change(int node, const ContactStepDirection& d, const VecX& dq,
                                   const VecX& impulses) const {
  const HeldNode& at = nodes_[static_cast<std::size_t>(node)];
  return at.force_change() * dq + at.given() * impulses + at.by_friction() * friction_changes(d) +
         (table_->e[node] * d.h) * load_;
}

VecX HeldStepTangent::start_velocity_change(const ContactStepDirection& d) {
  VecX dp = d.p.size() > 0 ? d.p : none_;
  if (d.q.size() > 0) dp -= start_mass_change_ * d.q;
  if (d.parameters != nullptr) {
    VecX heavier = none_;
    step_.add_momentum(record_->q0, v0_, *d.parameters, heavier);
    dp -= heavier;
  }
  return inverse_start_ * dp;
}

// Of the directions of the slips at the start.
VecX HeldStepTangent::start_turns(const ContactStepDirection& d) {
  VecX found = VecX::Zero(slides_);
  if (slides_ == 0) return found;
  const VecX& dq = d.q.size() > 0 ? d.q : none_;
  const VecX across = nodes_[0].watched().rightCols(slides_).transpose() * start_velocity_change(d) +
                      start_watched_.bottomRows(slides_) * dq;
  found = across.cwiseQuotient(start_slips_);
  found(slip_start_.begins()).setZero();
  slip_start_.add_turns(d, friction_changes(d), found);
  return found;
}

// What begins to slide is at rest: along a direction that moves it there is a kink.
void HeldStepTangent::check_start(const ContactStepDirection& d) {
  if (take_branch_ || (slides_ == 0 && record_->joints.empty())) return;
  const VecX& dq = d.q.size() > 0 ? d.q : none_;
  const VecX dv = start_velocity_change(d), size = start_sizes(d);
  const double still = kStill * (1.0 + v0_.cwiseAbs().maxCoeff());
  const auto refuse_moved = [&](int guard) {
    refuse("friction", guard, "A slip begins at rest, which a direction moves", "a direction that leaves it at rest",
           "one that does not", "Start in motion; on_kink='taken' gives the derivative of the slip that was taken");
  };
  const HeldNode& start = nodes_.front();
  const VecX along = start.along().transpose() * dv + start_along_ * dq;
  const VecX across = start.watched().rightCols(slides_).transpose() * dv + start_watched_.bottomRows(slides_) * dq;
  const double moved = std::max(d.size_q, dq.cwiseAbs().maxCoeff());
  const MatX gradients = start.along().cwiseAbs() + start.watched().rightCols(slides_).cwiseAbs();
  const MatX changes = start_along_.cwiseAbs() + start_watched_.bottomRows(slides_).cwiseAbs();
  const VecX sizes = gradients.transpose() * size + moved * changes.rowwise().sum();
  for (const int j : slip_start_.begins()) {
    if (std::hypot(along[j], across[j]) > kMoved * sizes[j])
      refuse_moved(record_->contacts[slide_of_[static_cast<std::size_t>(j)]].point.guard);
    if (d.t != 0.0 && slip_start_.depends_on_time())
      refuse("time", -1, "A slip begins beside a prescribed motion, at a time that moves", "a time that is given",
             "one that an event moves", "Start elsewhere");
  }
  for (const FrictionJoint& joint : record_->joints)
    if (!joint.sticks && std::abs(v0_[joint.dof]) <= still && std::abs(dv[joint.dof]) > kMoved * size[joint.dof])
      refuse_moved(-1);
}

bool HeldStepTangent::assess(const ContactStepDirection& d, const VecX& x, const VecX& start, const VecX& size,
                             VecRef off, VecRef end) {
  const MatX& u = record_->rates;
  const VecX& dq0 = d.q.size() > 0 ? d.q : none_;
  const Eigen::Map<const MatX> du(x.data(), nv_, stages_);
  MatX dv(nv_, stages_);
  dX_ = du * weights_;
  dX_nodes_ = du * to_nodes_;
  if (d.h != 0.0) {
    dX_ += (d.h / record_->h) * (u * weights_);
    dX_nodes_ += (d.h / record_->h) * (u * to_nodes_);
  }
  for (int i = 0; i < stages_; ++i)
    dv.col(i) = charts_[static_cast<std::size_t>(i)].velocity_change(u.col(i), du.col(i), dX_.col(i));
  StepDirection& step = step_direction_;
  step.q = d.q;
  step.p = d.p.size() > 0 ? d.p : none_;
  step.h = d.h;
  step.tau = d.tau;
  step.parameters = d.parameters;
  step.impulses.setZero(nv_, stages_);
  const VecX moved_start = nodes_[0].displacements() * dq0, anchors = anchor_changes(d, moved_start);
  for (int k = 0; k <= stages_; ++k) {
    const HeldNode& node = nodes_[static_cast<std::size_t>(k)];
    const VecX dX_k = dX_nodes_.col(k), dq = node.chart().turn(dX_k, dq0);
    if (k > 0) {
      VecX moved = node.displacements() * dq + node.rates() * (d.t + table_->d[k] * d.h);
      const double part = table_->d[k], left = (1.0 - part) * (1.0 - part) * (1.0 + 2.0 * part);
      moved.tail(held()) -= left * moved_start.tail(held()) + (1.0 - left) * anchors.tail(held());
      if (!rolling_.empty()) {
        const auto i = static_cast<std::size_t>(k - 1);
        const VecX turned = charts_[i].turn(dX_.col(k - 1), dq0);
        moved(rolling_) = record_->h * (roll_W_[i].transpose() * dv.col(k - 1) + roll_change_[i] * turned);
      }
      set_node(off, k - 1, moved);
    }
    if (k == stages_) break;
    const VecX change = force_change(k, d, dq, of_node(x, k, start));
    step.p += node.chart().at_start_change(node.force(), change, dX_k);
    const VecX given = node.chart().by_chart_change(node.force(), change, dX_k);
    for (int i = 0; i < stages_; ++i) step.impulses.col(i) += (table_->share[i][k] - 1.0) * given;
  }
  step_.resume(step, dv, dX_);
  step_.residual(off.head(stage_unknowns()));
  step_.finish(step, end.head(nv_), end.segment(nv_, nv_));
  VecX dv1;
  const bool agree = add_end_impulse(d, size, end, dv1);
  if (slides_ > 0) assess_slips(d, x, dv1, off);
  return agree;
}

// The velocity at the end changes by dv1.
bool HeldStepTangent::add_end_impulse(const ContactStepDirection& d, const VecX& size, VecRef end, VecX& dv1) {
  const HeldStepRecord& s = *record_;
  const HeldNode& node = nodes_.back();
  const VecX dq = end.head(nv_);
  VecX dp = VecX(end.segment(nv_, nv_)) + force_change(stages_, d, dq, VecX::Zero(rows_ + slides_));
  VecX heavier = end_mass_change_ * dq;
  if (d.parameters != nullptr) step_.add_momentum(node.configuration(), s.v1, *d.parameters, heavier);
  VecX faster = end_watched_ * dq + MinvC_.transpose() * (dp - heavier), impulses;
  faster.head(rows_) += node.accelerations() * (d.t + d.h);
  faster(undirected_).setZero();
  const bool agree = end_system_.solve(faster, size, impulses);
  dp += node.given() * impulses;
  end.segment(nv_, nv_) = dp;
  if (slides_ == 0 && rest_speeds_.cols() == 0) return agree;
  dv1 = dp - heavier;
  masses_.solve_mass(dv1);
  end.tail(rest_speeds_.cols()) = rest_speeds_.transpose() * dv1 + rest_changes_ * dq;
  return agree;
}

// The slips across their directions at the nodes between both ends, over the step.
void HeldStepTangent::assess_slips(const ContactStepDirection& d, const VecX& x, const VecX& dv1, VecRef off) {
  const HeldStepRecord& s = *record_;
  const VecX& dq0 = d.q.size() > 0 ? d.q : none_;
  const Eigen::Map<const MatX> du(x.data(), nv_, stages_);
  const NodeChart& end = nodes_.back().chart();
  const VecX dX_end = dX_nodes_.col(stages_), dv0 = start_velocity_change(d);
  const VecX drate = end.rate(dv1 - end.velocity_change(end_rate_, none_, dX_end));
  for (int k = 1; k < stages_; ++k) {
    const HeldNode& node = nodes_[static_cast<std::size_t>(k)];
    const VecX dq = node.chart().turn(dX_nodes_.col(k), dq0);
    const VecX du_k =
        du * raised_.rate.col(k - 1) + raised_.rate_by_start[k - 1] * dv0 + raised_.rate_by_end[k - 1] * drate;
    VecX dX_k = s.h * (du * raised_.moved.col(k - 1) + raised_.moved_by_start[k - 1] * dv0 +
                       raised_.moved_by_end[k - 1] * drate);
    dX_k += (d.h / s.h) * raised_X_.col(k - 1);
    const VecX dv =
        raised_charts_[static_cast<std::size_t>(k - 1)].velocity_change(raised_rates_.col(k - 1), du_k, dX_k);
    const VecX across = node.watched().rightCols(slides_).transpose() * dv +
                        node_watched_[static_cast<std::size_t>(k - 1)].bottomRows(slides_) * dq;
    const VecX turned = x.segment(turns_at(k), slides_);
    off.segment(turns_at(k), slides_) = s.h * (across - node_slips_.col(k - 1).cwiseProduct(turned));
  }
}

MatX HeldStepTangent::slips_by_rate(const VecX& rate_share, const VecX& moved_share) const {
  MatX found(turns(), nv_);
  for (int k = 1; k < stages_; ++k) {
    const MatX across = nodes_[static_cast<std::size_t>(k)].watched().rightCols(slides_).transpose();
    for (int c = 0; c < nv_; ++c) {
      const VecX unit = VecX::Unit(nv_, c);
      const VecX dv = raised_charts_[static_cast<std::size_t>(k - 1)].velocity_change(
          raised_rates_.col(k - 1), rate_share[k - 1] * unit, (record_->h * moved_share[k - 1]) * unit);
      found.col(c).segment((k - 1) * slides_, slides_) = record_->h * (across * dv);
    }
  }
  return found;
}

// What the rows of displacements of material points, and of joints, count from changes by; start: the changes of these
// at the start.
VecX HeldStepTangent::anchor_changes(const ContactStepDirection& d, const VecX& start) const {
  VecX found = VecX::Zero(rows_);
  for (std::size_t i = 0; i < record_->contacts.size(); ++i) {
    const PersistentContact& c = record_->contacts[i];
    const int r = fixed_ + phase_.row(i) + 1;
    if (!c.keeps_place()) continue;
    if (!c.anchored) found.segment<2>(r) = start.segment<2>(r);
    if (c.anchored && d.anchors.size() > 0)
      found.segment<2>(r) = HeldNode::tangents(c) * d.anchors.col(static_cast<Eigen::Index>(i));
  }
  for (std::size_t k = 0; k < record_->joints.size(); ++k)
    if (const int r = phase_.joint_row(k); r >= 0) found[fixed_ + r] = start[fixed_ + r];
  return found;
}

void HeldStepTangent::make_matrix() {
  const int count = unknowns(), own = stage_unknowns(), held = count - own;
  const VecX start = VecX::Zero(slides_), none = VecX::Zero(rows_ + slides_);
  matrix_.resize(count, count);
  ends_.resize(end_size(), count);
  VecX x = VecX::Zero(count);
  for (int k = 0; k < count; ++k) {
    x[k] = 1.0;
    assess(kNoDirection, x, start, none, matrix_.col(k), ends_.col(k));
    x[k] = 0.0;
  }
  stage_factor_.compute(matrix_.topLeftCorner(own, own));
  answers_ = stage_factor_.solve(matrix_.topRightCorner(own, held));
  if (!answers_.allFinite()) refuse_unsolved();
  row_system_.compute(matrix_.bottomRightCorner(held, held) - matrix_.bottomLeftCorner(held, own) * answers_,
                      stages_ * fixed_, turns());
  const MatX& free = row_system_.free();
  if (free.cols() == 0 || !((answers_ * free).cwiseAbs().maxCoeff() > kShared * answers_.cwiseAbs().maxCoeff())) return;
  if (record_->contacts.empty())
    refuse("redundant", -1, "The motion depends on how constraints share their load",
           "gradients of constraints that depend on each other, or clearly do not", "a nearly singular configuration",
           "Start elsewhere, or use fewer constraints");
  refuse("redundant", first_guard(), "The motion depends on how contact points share their load",
         "a motion that the laws of contact determine", "points near a singular configuration", "Start elsewhere");
}

VecX HeldStepTangent::solve_matrix(const VecX& right, const VecX& size, bool& agree) const {
  const int own = stage_unknowns(), held = unknowns() - own;
  VecX x(unknowns()), lambda;
  x.head(own) = -stage_factor_.solve(right.head(own));
  agree = row_system_.solve(right.tail(held) + matrix_.bottomLeftCorner(held, own) * x.head(own), size, lambda);
  x.head(own) -= answers_ * lambda;
  x.tail(held) = lambda;
  return x;
}

VecX HeldStepTangent::solve_transposed(const VecX& right) const {
  const int own = stage_unknowns(), held = unknowns() - own;
  VecX mu(unknowns());
  mu.tail(held) = row_system_.solve_transposed(right.tail(held) - answers_.transpose() * right.head(own));
  const VecX rest = right.head(own) + matrix_.bottomLeftCorner(held, own).transpose() * mu.tail(held);
  const auto upper = stage_factor_.matrixLU().triangularView<Eigen::Upper>();
  const auto lower = stage_factor_.matrixLU().triangularView<Eigen::UnitLower>();
  const VecX solved = lower.transpose().solve(upper.transpose().solve(rest));
  mu.head(own) = -(stage_factor_.permutationP().transpose() * solved);
  return mu;
}

// Of the terms of the change of the velocity at the start, (nv,).
VecX HeldStepTangent::start_sizes(const ContactStepDirection& d) const {
  const double q = std::max(d.size_q, d.q.size() > 0 ? d.q.cwiseAbs().maxCoeff() : 0.0);
  const double p = std::max(d.size_p, d.p.size() > 0 ? d.p.cwiseAbs().maxCoeff() : 0.0);
  return VecX::Constant(nv_, q / record_->h) + p * inverse_start_.cwiseAbs().rowwise().sum();
}

// Of the terms of speeds with gradients C at the end.
VecX HeldStepTangent::speed_sizes(const ContactStepDirection& d, const MatX& C, const MatX& MinvC) const {
  const double q = std::max(d.size_q, d.q.size() > 0 ? d.q.cwiseAbs().maxCoeff() : 0.0);
  const double p = std::max(d.size_p, d.p.size() > 0 ? d.p.cwiseAbs().maxCoeff() : 0.0);
  return (q / record_->h * C.cwiseAbs() + p * MinvC.cwiseAbs()).colwise().sum().transpose();
}

void HeldStepTangent::solve(const ContactStepDirection& d, VecRef dq1, VecRef dp1) {
  check_start(d);
  const int own = stage_unknowns();
  VecX x = VecX::Zero(unknowns()), off(unknowns()), end(end_size());
  const VecX size = speed_sizes(d, nodes_.back().watched(), MinvC_), none = VecX::Zero(unknowns() - own),
             start = start_turns(d);
  VecX sizes(unknowns());
  for (int k = 0; k < stages_; ++k) {
    set_node(sizes, k, record_->h * size.head(rows_));
    if (k > 0) sizes.segment(turns_at(k), slides_) = record_->h * size.tail(slides_);
  }
  bool agree = true, settled = true;
  for (int pass = 0; pass < kPasses; ++pass) {
    assess(d, x, start, size, off, end);
    x += solve_matrix(off, pass == 0 ? VecX(sizes.tail(none.size())) : none, pass == 0 ? agree : settled);
  }
  const bool ends = assess(d, x, start, size, off, end);
  if (!end.allFinite()) refuse_unsolved();
  if (!ends || !agree)
    refuse("redundant", first_guard(), "Contact points that share their load contradict each other along a direction",
           "a direction that keeps the points of a face closed together", "one that opens some of them",
           "Start with the bodies apart, or in touch at one point");
  dq1 = end.head(nv_);
  dp1 = end.segment(nv_, nv_);
  slip_changes_ = end.tail(rest_speeds_.cols());
  const double moved = std::max(d.size_q, end.head(nv_).cwiseAbs().maxCoeff());
  slip_sizes_ = speed_sizes(d, rest_speeds_, MinvR_) + moved * rest_changes_.cwiseAbs().rowwise().sum();
}

}  // namespace contactvi

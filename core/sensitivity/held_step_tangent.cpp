#include "sensitivity/held_step_tangent.hpp"

#include <algorithm>

namespace contactvi {

namespace {
constexpr double kShared = 1e-7;  // of the effect of all impulses: what is shared has less
constexpr int kPasses = 3;        // the first solves, the others take the rounding off
const ContactStepDirection kNoDirection;
}  // namespace

HeldStepTangent::HeldStepTangent(const Scene& scene, int stages, int contact_points)
    : scene_(&scene),
      tree_(&scene.tree),
      nv_(scene.tree.nv),
      stages_(stages),
      fixed_(scene.tree.elements.constraint_rows),
      table_(&lobatto_table(stages)),
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
      dp_mass_(scene.tree.nv),
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

VecX HeldStepTangent::of_node(const VecX& x, int node) const {
  VecX found(rows_);
  found.head(fixed_) = x.segment(stage_unknowns() + node * fixed_, fixed_);
  found.tail(held()) = x.segment(stage_unknowns() + stages_ * fixed_ + node * held(), held());
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
  make_matrix();
  take_end();
}

void HeldStepTangent::place_nodes() {
  const HeldStepRecord& s = *record_;
  const MatX X = s.rates * weights_, X_nodes = s.rates * to_nodes_;
  for (int i = 0; i < stages_; ++i) {
    NodeChart& chart = charts_[static_cast<std::size_t>(i)];
    chart.take(X.col(i));
    velocities_.col(i) = chart.velocity(s.rates.col(i));
  }
  static const std::vector<FrictionJoint> no_joints;
  phase_.set(s.contacts, no_joints, 2 * stages_ + 1);
  rows_ = fixed_ + phase_.count();
  rolling_.clear();
  for (int r = 0; r < phase_.count(); ++r)
    if (phase_.by_rate(r)) rolling_.push_back(fixed_ + r);
  VecX q(tree_->nq);
  const auto place = [&](HeldNode& node, double part, const VecX& X_node, const VecX& lambda, int number) {
    integrate(*tree_, s.q0, X_node, 1.0, q);
    if (node.take(q, s.t + part * s.h, X_node, lambda, s.contacts, phase_, number)) return;
    refuse("witness", node.refused(), "The gap of a persistent contact has no second derivative",
           "one pair of nearest points", node.why(), "Start elsewhere, or round the edges of the shapes");
  };
  for (int k = 0; k <= stages_; ++k)
    place(nodes_[static_cast<std::size_t>(k)], table_->d[k], X_nodes.col(k), s.lambda.col(k), k);
  roll_W_.clear();
  roll_change_.clear();
  for (int i = 0; i < stages_ && !rolling_.empty(); ++i) {
    place(at_stage_, gauss_table(stages_).c[i], X.col(i), VecX::Zero(rows_), stages_ + 1 + i);
    roll_W_.push_back(at_stage_.gradients()(Eigen::all, rolling_));
    roll_change_.push_back(at_stage_.speed_change(velocities_.col(i))(rolling_, Eigen::all));
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

void HeldStepTangent::assess(const ContactStepDirection& d, const VecX& x, VecRef off, VecRef dq1, VecRef dp1) {
  const MatX& u = record_->rates;
  const VecX& dq0 = d.q.size() > 0 ? d.q : none_;
  const Eigen::Map<const MatX> du(x.data(), nv_, stages_);
  MatX dX = du * weights_, dX_nodes = du * to_nodes_, dv(nv_, stages_);
  if (d.h != 0.0) {
    dX += (d.h / record_->h) * (u * weights_);
    dX_nodes += (d.h / record_->h) * (u * to_nodes_);
  }
  for (int i = 0; i < stages_; ++i)
    dv.col(i) = charts_[static_cast<std::size_t>(i)].velocity_change(u.col(i), du.col(i), dX.col(i));
  StepDirection& step = step_direction_;
  step.q = d.q;
  step.p = d.p.size() > 0 ? d.p : none_;
  step.h = d.h;
  step.tau = d.tau;
  step.parameters = d.parameters;
  step.impulses.setZero(nv_, stages_);
  const VecX start = nodes_[0].displacements() * dq0, anchors = anchor_changes(d, start);
  for (int k = 0; k <= stages_; ++k) {
    const HeldNode& node = nodes_[static_cast<std::size_t>(k)];
    const VecX dX_k = dX_nodes.col(k), dq = node.chart().turn(dX_k, dq0);
    if (k > 0) {
      VecX moved = node.displacements() * dq + node.rates() * (d.t + table_->d[k] * d.h);
      const double part = table_->d[k], left = (1.0 - part) * (1.0 - part) * (1.0 + 2.0 * part);
      moved.tail(held()) -= left * start.tail(held()) + (1.0 - left) * anchors.tail(held());
      if (!rolling_.empty()) {
        const auto i = static_cast<std::size_t>(k - 1);
        const VecX turned = charts_[i].turn(dX.col(k - 1), dq0);
        moved(rolling_) = record_->h * (roll_W_[i].transpose() * dv.col(k - 1) + roll_change_[i] * turned);
      }
      set_node(off, k - 1, moved);
    }
    if (k == stages_) break;
    const VecX change = node.force_change() * dq + node.gradients() * of_node(x, k);
    step.p += node.chart().at_start_change(node.force(), change, dX_k);
    const VecX given = node.chart().by_chart_change(node.force(), change, dX_k);
    for (int i = 0; i < stages_; ++i) step.impulses.col(i) += (table_->share[i][k] - 1.0) * given;
  }
  step_.resume(step, dv, dX);
  step_.residual(off.head(stage_unknowns()));
  step_.finish(step, dq1, dp1);
}

// What the rows of displacements of material points count from changes by; start: the changes of these at the start.
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
  return found;
}

void HeldStepTangent::make_matrix() {
  const int count = unknowns(), own = stage_unknowns(), held = count - own;
  matrix_.resize(count, count);
  ends_.resize(2 * nv_, count);
  VecX x = VecX::Zero(count);
  for (int k = 0; k < count; ++k) {
    x[k] = 1.0;
    assess(kNoDirection, x, matrix_.col(k), ends_.col(k).head(nv_), ends_.col(k).tail(nv_));
    x[k] = 0.0;
  }
  stage_factor_.compute(matrix_.topLeftCorner(own, own));
  answers_ = stage_factor_.solve(matrix_.topRightCorner(own, held));
  if (!answers_.allFinite()) refuse_unsolved();
  row_system_.compute(-matrix_.bottomLeftCorner(held, own) * answers_, stages_ * fixed_);
  const MatX& free = row_system_.free();
  if (free.cols() == 0 || !((answers_ * free).cwiseAbs().maxCoeff() > kShared * answers_.cwiseAbs().maxCoeff())) return;
  if (record_->contacts.empty())
    refuse("redundant", -1, "The motion depends on how constraints share their load",
           "gradients of constraints that depend on each other, or clearly do not", "a nearly singular configuration",
           "Start elsewhere, or use fewer constraints");
  refuse("redundant", first_guard(), "The motion depends on how contact points share their load",
         "a motion that the laws of contact determine", "points near a singular configuration", "Start elsewhere");
}

// The equations of the impulse at the end.
void HeldStepTangent::take_end() {
  const HeldNode& end = nodes_.back();
  masses_.place_node(end.configuration());
  MinvW_ = end.gradients();
  masses_.solve_masses(MinvW_);
  end_system_.compute(end.gradients().transpose() * MinvW_, fixed_);
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

// Of the terms of the rows over such a length of time [s].
VecX HeldStepTangent::row_sizes(const ContactStepDirection& d, double length) const {
  const double q = std::max(d.size_q, d.q.size() > 0 ? d.q.cwiseAbs().maxCoeff() : 0.0);
  const double p = std::max(d.size_p, d.p.size() > 0 ? d.p.cwiseAbs().maxCoeff() : 0.0);
  const MatX& W = nodes_.back().gradients();
  return length * (q / record_->h * W.cwiseAbs() + p * MinvW_.cwiseAbs()).colwise().sum().transpose();
}

void HeldStepTangent::solve(const ContactStepDirection& d, VecRef dq1, VecRef dp1) {
  VecX x = VecX::Zero(unknowns()), off(unknowns()), dq(nv_), dp(nv_);
  const VecX size = row_sizes(d, record_->h), none = VecX::Zero(rows_ * stages_);
  VecX sizes(rows_ * stages_);
  for (int k = 0; k < stages_; ++k) {
    sizes.segment(k * fixed_, fixed_) = size.head(fixed_);
    sizes.segment(stages_ * fixed_ + k * held(), held()) = size.tail(held());
  }
  bool agree = true, settled = true;
  for (int pass = 0; pass < kPasses; ++pass) {
    assess(d, x, off, dq, dp);
    x += solve_matrix(off, pass == 0 ? sizes : none, pass == 0 ? agree : settled);
  }
  assess(d, x, off, dq, dp);
  if (!dq.allFinite() || !dp.allFinite()) refuse_unsolved();
  HeldNode& end = nodes_.back();
  const VecX& q1 = end.configuration();
  step_.momentum(q1, record_->v1, dq, none_, dp_mass_);
  if (d.parameters != nullptr) step_.add_momentum(q1, record_->v1, *d.parameters, dp_mass_);
  dp += end.force_change() * dq;
  VecX lambda;
  const VecX faster =
      end.speed_change(record_->v1) * dq + MinvW_.transpose() * (dp - dp_mass_) + end.accelerations() * (d.t + d.h);
  if (!end_system_.solve(faster, row_sizes(d, 1.0), lambda) || !agree)
    refuse("redundant", first_guard(), "Contact points that share their load contradict each other along a direction",
           "a direction that keeps the points of a face closed together", "one that opens some of them",
           "Start with the bodies apart, or in touch at one point");
  dq1 = dq;
  dp1 = dp + end.gradients() * lambda;
}

}  // namespace contactvi

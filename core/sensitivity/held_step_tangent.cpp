#include "sensitivity/held_step_tangent.hpp"

namespace contactvi {

namespace {
constexpr double kShared = 1e-7;  // of the effect of all impulses: what is shared has less
constexpr int kPasses = 3;        // the first solves, the others take the rounding off
const ContactStepDirection kNoDirection;
}  // namespace

HeldStepTangent::HeldStepTangent(const Scene& scene, int stages)
    : scene_(&scene),
      tree_(&scene.tree),
      nv_(scene.tree.nv),
      stages_(stages),
      table_(&lobatto_table(stages)),
      step_(scene.tree, stages),
      masses_(scene.tree, 1, 1e-12, 1),
      nodes_(static_cast<std::size_t>(stages) + 1, HeldNode(scene.tree)),
      charts_(static_cast<std::size_t>(stages), NodeChart(scene.tree)),
      weights_(stages, stages),
      to_nodes_(stages, stages + 1),
      velocities_(scene.tree.nv, stages),
      dp_mass_(scene.tree.nv),
      none_(VecX::Zero(scene.tree.nv)) {}

void HeldStepTangent::refuse(const char* reason, const char* fact, const char* expected, const char* got,
                             const char* remedy) const {
  throw NoDerivative({reason, -1, record_->t}, fact, expected, got, remedy);
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
  VecX q(tree_->nq);
  for (int k = 0; k <= stages_; ++k) {
    integrate(*tree_, s.q0, X_nodes.col(k), 1.0, q);
    nodes_[static_cast<std::size_t>(k)].take(q, s.t + table_->d[k] * s.h, X_nodes.col(k), s.lambda.col(k));
  }
  rows_ = nodes_[0].rows();
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
  for (int k = 0; k <= stages_; ++k) {
    const HeldNode& node = nodes_[static_cast<std::size_t>(k)];
    const VecX dX_k = dX_nodes.col(k), dq = node.chart().turn(dX_k, dq0);
    if (k > 0)
      off.segment(unknown_at(k - 1, 0), rows_) =
          node.gradients().transpose() * dq + node.rates() * (d.t + table_->d[k] * d.h);
    if (k == stages_) break;
    const VecX change = node.force_change() * dq + node.gradients() * x.segment(unknown_at(k, 0), rows_);
    step.p += node.chart().at_start_change(node.force(), change, dX_k);
    const VecX given = node.chart().by_chart_change(node.force(), change, dX_k);
    for (int i = 0; i < stages_; ++i) step.impulses.col(i) += (table_->share[i][k] - 1.0) * given;
  }
  step_.resume(step, dv, dX);
  step_.residual(off.head(stage_unknowns()));
  step_.finish(step, dq1, dp1);
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
  if (!answers_.allFinite())
    refuse("step", "The derivative of a step was not solved", "tangent equations with a solution", "none",
           "Use a smaller dt");
  row_system_.compute(-matrix_.bottomLeftCorner(held, own) * answers_, held);
  const MatX& free = row_system_.free();
  if (free.cols() > 0 && (answers_ * free).cwiseAbs().maxCoeff() > kShared * answers_.cwiseAbs().maxCoeff())
    refuse("redundant", "The motion depends on how constraints share their load",
           "gradients of constraints that depend on each other, or clearly do not", "a nearly singular configuration",
           "Start elsewhere, or use fewer constraints");
}

// The equations of the impulse at the end.
void HeldStepTangent::take_end() {
  const HeldNode& end = nodes_.back();
  VecX q(tree_->nq);
  integrate(*tree_, record_->q0, end.displacement(), 1.0, q);
  masses_.place_node(q);
  MinvW_ = end.gradients();
  masses_.solve_masses(MinvW_);
  end_system_.compute(end.gradients().transpose() * MinvW_, rows_);
}

VecX HeldStepTangent::solve_matrix(const VecX& right) const {
  const int own = stage_unknowns(), held = unknowns() - own;
  VecX x(unknowns()), lambda;
  x.head(own) = -stage_factor_.solve(right.head(own));
  row_system_.solve(right.tail(held) + matrix_.bottomLeftCorner(held, own) * x.head(own), VecX::Zero(held), lambda);
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

void HeldStepTangent::solve(const ContactStepDirection& d, VecRef dq1, VecRef dp1) {
  VecX x = VecX::Zero(unknowns()), off(unknowns()), dq(nv_), dp(nv_);
  for (int pass = 0; pass < kPasses; ++pass) {
    assess(d, x, off, dq, dp);
    x += solve_matrix(off);
  }
  assess(d, x, off, dq, dp);
  if (!dq.allFinite() || !dp.allFinite())
    refuse("step", "The derivative of a step was not solved", "tangent equations with a solution", "none",
           "Use a smaller dt");
  HeldNode& end = nodes_.back();
  VecX q1(tree_->nq);
  integrate(*tree_, record_->q0, end.displacement(), 1.0, q1);
  step_.momentum(q1, record_->v1, dq, none_, dp_mass_);
  if (d.parameters != nullptr) step_.add_momentum(q1, record_->v1, *d.parameters, dp_mass_);
  dp += end.force_change() * dq;
  VecX lambda;
  const VecX faster =
      end.speed_change(record_->v1) * dq + MinvW_.transpose() * (dp - dp_mass_) + end.accelerations() * (d.t + d.h);
  end_system_.solve(faster, VecX::Zero(rows_), lambda);
  dq1 = dq;
  dp1 = dp + end.gradients() * lambda;
}

}  // namespace contactvi

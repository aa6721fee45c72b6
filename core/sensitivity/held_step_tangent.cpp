#include "sensitivity/held_step_tangent.hpp"
#include "sensitivity/kinks.hpp"
#include "sensitivity/known_laws.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {
constexpr int kPasses = 3;  // the first solves, the others take the rounding off
const ContactStepDirection kNoDirection;
}  // namespace

HeldStepTangent::HeldStepTangent(const Scene& scene, int stages, int contact_points, Kinks& kinks)
    : scene_(&scene),
      tree_(&scene.tree),
      nv_(scene.tree.nv),
      stages_(stages),
      kinks_(&kinks),
      fixed_(scene.tree.elements.constraint_rows),
      table_(&lobatto_table(stages)),
      step_(scene.tree, stages),
      guards_(scene, contact_points),
      phase_(guards_, scene.tree.nv),
      at_stage_(scene),
      nodes_(static_cast<std::size_t>(stages) + 1, HeldNode(scene)),
      charts_(static_cast<std::size_t>(stages), NodeChart(scene.tree)),
      weights_(stages, stages),
      to_nodes_(stages, stages + 1),
      velocities_(scene.tree.nv, stages),
      start_(scene, kinks),
      slips_(scene.tree, stages),
      end_(scene),
      none_(VecX::Zero(scene.tree.nv)) {}

void HeldStepTangent::refuse(const char* reason, int guard, const char* fact, const char* expected,
                             const std::string& got, const char* remedy) const {
  throw NoDerivative({reason, guard, record_->t}, fact, expected, got, remedy);
}

void HeldStepTangent::meet(const char* reason, const char* fact, const char* expected, const std::string& got,
                           const char* remedy) const {
  kinks_->meet(NoDerivative({reason, first_guard(), record_->t}, fact, expected, got, remedy));
}

void HeldStepTangent::refuse_unsolved() const {
  refuse("step", -1, "The derivative of a step was not solved", "tangent equations with a solution", "none",
         "Use a smaller dt");
}

int HeldStepTangent::first_guard() const {
  return record_->contacts.empty() ? -1 : record_->contacts.front().point.guard;
}

VecX HeldStepTangent::of_node(const VecX& x, int node, const VecX& start) const {
  VecX found(rows_ + numbers());
  found.head(fixed_) = x.segment(stage_unknowns() + node * fixed_, fixed_);
  found.segment(fixed_, held()) = x.segment(stage_unknowns() + stages_ * fixed_ + node * held(), held());
  found.tail(numbers()) = node == 0 ? start : VecX(x.segment(turns_at(node), numbers()));
  return found;
}

void HeldStepTangent::set_node(VecRef x, int node, const VecX& values) const {
  x.segment(stage_unknowns() + node * fixed_, fixed_) = values.head(fixed_);
  x.segment(stage_unknowns() + stages_ * fixed_ + node * held(), held()) = values.tail(held());
}

void HeldStepTangent::take(const HeldStepRecord& step, const VecX& tau, const Servo* servo) {
  record_ = &step;
  if (step.ending == HeldStepEnd::kBorder && step.contacts[static_cast<std::size_t>(step.ended)].slides())
    refuse("witness", step.contacts[static_cast<std::size_t>(step.ended)].point.guard,
           "A contact that slides with friction comes to another feature of its shape",
           "contacts that stick, roll or have no friction where the nearest feature changes", "one that slides",
           "Start elsewhere, or set friction=0 for the pair");
  const GaussTable& gauss = gauss_table(stages_);
  for (int j = 0; j < stages_; ++j) {
    for (int i = 0; i < stages_; ++i) weights_(j, i) = step.h * gauss.A[i][j];
    for (int k = 0; k <= stages_; ++k) to_nodes_(j, k) = step.h * table_->to_node[k][j];
  }
  place_nodes();
  give_impulses();
  step_.take(step.q0, p_start_, step.h, tau, step.t, servo, velocities_);
  step_.add_impulses(impulses_);
  if (slides()) start_.take(nodes_.front(), step, phase_, tau, servo, step_);
  end_.take(nodes_.back(), step, phase_, fixed_, step_);
  if (slides_ > 0 && !slips_.take(step, nodes_, start_.velocity()))
    refuse("friction", first_guard(), "A slip turns back within a step", "slips that go on to the end of the step",
           "one that does not", "Use a smaller dt");
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
  for (const PersistentContact& c : s.contacts)
    if (s.lacks_laws) require_plain_law(*scene_, c.point.guard, s.t);
  phase_.set(s.contacts, s.joints, 2 * stages_ + 1);
  rows_ = fixed_ + phase_.count();
  slides_ = static_cast<int>(phase_.slides().size());
  varies_ = false;
  for (int j = 0; j < slides_; ++j) varies_ = varies_ || phase_.friction_varies(j);
  rolling_.clear();
  for (int r = 0; r < phase_.count(); ++r)
    if (phase_.by_rate(r)) rolling_.push_back(fixed_ + r);
  slide_of_.clear();
  for (std::size_t i = 0; i < s.contacts.size(); ++i)
    if (phase_.slide(i) >= 0) slide_of_.push_back(i);
  VecX q(tree_->nq);
  const std::vector<std::array<int, 2>> features = find_features(X.col(stages_ / 2));
  const auto place = [&](HeldNode& node, double part, const VecX& X_node, const HeldNode::Acting& acting, int number) {
    integrate(*tree_, s.q0, X_node, 1.0, q);
    node.prefer(features);
    if (node.take(q, s.t + part * s.h, X_node, acting, s, phase_, number)) return;
    refuse("witness", node.refused(), "The gap of a persistent contact has no second derivative",
           "one pair of nearest points", node.why(), "Start elsewhere, or round the edges of the shapes");
  };
  for (int k = 0; k <= stages_; ++k)
    place(nodes_[static_cast<std::size_t>(k)], table_->d[k], X_nodes.col(k), acting(k), k);
  const VecX none = VecX::Zero(slides_);
  roll_W_.clear();
  roll_change_.clear();
  roll_rates_.clear();
  MatX watched, along;
  for (int i = 0; i < stages_ && !rolling_.empty(); ++i) {
    place(at_stage_, gauss_table(stages_).c[i], X.col(i), {VecX::Zero(rows_), 0.0, none, none, VecX()},
          stages_ + 1 + i);
    roll_W_.push_back(at_stage_.gradients()(Eigen::all, rolling_));
    at_stage_.change_speeds(velocities_.col(i), watched, along);
    roll_change_.push_back(watched(rolling_, Eigen::all));
    roll_rates_.push_back(at_stage_.speed_rates(velocities_.col(i))(rolling_));
  }
}

// What acts at a node of the step.
HeldNode::Acting HeldStepTangent::acting(int node) const {
  const HeldStepRecord& s = *record_;
  const bool by_forces = slides_ > 0 && phase_.friction_by_forces();
  HeldNode::Acting found{s.lambda.col(node),
                         s.h * table_->e[node],
                         VecX(slides_),
                         VecX(slides_),
                         VecX::Zero(varies_ ? slides_ : 0),
                         VecX::Zero(by_forces ? slides_ : 0),
                         VecX::Zero(by_forces ? slides_ : 0)};
  if (slides_ > 0) found.angles = s.angles.col(node);
  for (int j = 0; j < slides_; ++j) {
    const std::size_t i = slide_of_[static_cast<std::size_t>(j)];
    found.mu[j] = s.contacts[i].mu;
    if (!phase_.friction_varies(j)) continue;
    const double normal = found.lambda[fixed_ + phase_.row(i)] / found.weight;
    const FrictionState friction =
        phase_.friction(i, std::abs(s.slips(j, node)), normal, s.t + table_->d[node] * s.h, found.mu[j], true);
    found.mu[j] = friction.mu;
    found.slopes[j] = friction.by_slip;
    if (!by_forces) continue;
    found.by_normal[j] = friction.by_normal;
    found.by_time[j] = friction.by_time;
  }
  return found;
}

// Those at which contacts touch at a stage in the middle of the step, and so all along it: it ends where one comes to
// another feature.
std::vector<std::array<int, 2>> HeldStepTangent::find_features(const VecX& X) {
  std::vector<std::array<int, 2>> found(record_->contacts.size(), {-1, -1});
  VecX q(tree_->nq);
  integrate(*tree_, record_->q0, X, 1.0, q);
  for (std::size_t i = 0; i < found.size(); ++i) {
    const ContactPoint& point = record_->contacts[i].point;
    if (point.kind != PointKind::kWitness) continue;
    ContactTangent middle(*scene_);
    Contact contact;
    guards_.place(q);
    guards_.evaluate_witness(point.guard, contact);
    if (middle.take(q, point.guard, contact, &point))
      found[i] = {middle.surface(0).number(), middle.surface(1).number()};
  }
  return found;
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
         (table_->e[node] * d.h) * at.length_change() + (d.t + table_->d[node] * d.h) * at.force_rate();
}

// Of the numbers of the slips at the start.
VecX HeldStepTangent::start_numbers(const ContactStepDirection& d) {
  return slides_ > 0 ? start_.turns(d, friction_changes(d)) : VecX();
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
  step.t = d.t;
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
        const double later = d.t + gauss_table(stages_).c[k - 1] * d.h;
        moved(rolling_) =
            record_->h * (roll_W_[i].transpose() * dv.col(k - 1) + roll_change_[i] * turned + later * roll_rates_[i]);
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
  const VecX dq1 = end.head(nv_);
  end.segment(nv_, nv_) += force_change(stages_, d, dq1, VecX::Zero(rows_ + numbers()));
  VecX heavier = none_, dv1;
  if (d.parameters != nullptr) step_.add_momentum(nodes_.back().configuration(), record_->v1, *d.parameters, heavier);
  const bool agree = end_.add_impulse(heavier, d.t + d.h, size, end, dv1);
  if (slides_ == 0) return agree;
  const VecX dv0 = start_.velocity_change(d);
  for (int k = 1; k < stages_; ++k)
    off.segment(turns_at(k), numbers()) = slips_.change(k, du, dv0, dv1, dX_nodes_, dq0, d.h, d.t + table_->d[k] * d.h,
                                                        x.segment(turns_at(k), numbers()));
  return agree;
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
  const VecX start = VecX::Zero(numbers()), none = VecX::Zero(rows_ + numbers());
  matrix_.resize(count, count);
  ends_.resize(end_.size(), count);
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
    meet("redundant", "The motion depends on how constraints share their load",
         "gradients of constraints that depend on each other, or clearly do not", "a nearly singular configuration",
         "Start elsewhere, or use fewer constraints");
  else
    meet("redundant", "The motion depends on how contact points share their load",
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

void HeldStepTangent::solve(const ContactStepDirection& d, VecRef dq1, VecRef dp1) {
  if (slides()) start_.check(d);
  const int own = stage_unknowns();
  VecX x = VecX::Zero(unknowns()), off(unknowns()), end(end_.size());
  const VecX none = VecX::Zero(unknowns() - own), start = start_numbers(d);
  assess(d, x, start, VecX::Zero(rows_ + numbers()), off, end);
  // What the direction alone changes: of the momenta of the stages, as by inputs, and of the time or the length, in
  // which forces and reactions may cancel.
  double reactions = 0.0;
  for (const HeldNode& node : nodes_) reactions += node.force().cwiseAbs().maxCoeff();
  const double q = std::max(
                   {d.size_q, d.q.size() > 0 ? d.q.cwiseAbs().maxCoeff() : 0.0, end.head(nv_).cwiseAbs().maxCoeff()}),
               h = record_->h,
               p = std::max({d.size_p, d.p.size() > 0 ? d.p.cwiseAbs().maxCoeff() : 0.0,
                             end.segment(nv_, nv_).cwiseAbs().maxCoeff(), off.head(own).cwiseAbs().maxCoeff(),
                             std::abs(d.h) / h * reactions});
  const VecX size = end_.speed_sizes(q, p, h);
  VecX sizes(unknowns());
  for (int k = 0; k < stages_; ++k) {
    set_node(sizes, k, record_->h * size.head(rows_));
    if (k > 0) sizes.segment(turns_at(k), numbers()) = record_->h * size.tail(numbers());
  }
  bool agree = true, settled = true;
  for (int pass = 0; pass < kPasses; ++pass) {
    if (pass > 0) assess(d, x, start, size, off, end);
    x += solve_matrix(off, pass == 0 ? VecX(sizes.tail(none.size())) : none, pass == 0 ? agree : settled);
  }
  const bool ends = assess(d, x, start, size, off, end);
  if (!end.allFinite()) refuse_unsolved();
  if (!ends || !agree)
    meet("redundant", "Contact points that share their load contradict each other along a direction",
         "a direction that keeps the points of a face closed together", "one that opens some of them",
         "Start with the bodies apart, or in touch at one point; on_kink='taken' keeps them closed");
  dq1 = end.head(nv_);
  dp1 = end.segment(nv_, nv_);
  slip_changes_ = end.tail(end_.rests());
  slip_sizes_ = end_.rest_sizes(std::max(q, dq1.cwiseAbs().maxCoeff()), p, h);
}

}  // namespace contactvi

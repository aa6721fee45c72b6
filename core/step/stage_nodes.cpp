#include "step/stage_nodes.hpp"

#include <cmath>
#include <limits>

#include "step/ball_chart.hpp"

namespace contactvi {

namespace {
constexpr double kSameDirection = 1e-6;  // of unit vectors: directions of forces that differ by less are the same
}  // namespace

StageNodes::Node::Node(const Tree& tree) : q(tree.nq), X(VecX::Zero(tree.nv)), at(tree) {}

StageNodes::StageNodes(const Tree& tree, int stages)
    : tree_(&tree),
      table_(&lobatto_table(stages)),
      fixed_(tree.elements.constraint_rows),
      rows_(fixed_),
      stages_(stages),
      v0_(tree.nv),
      nodes_(stages + 1, Node(tree)),
      q_stage_(tree.nq),
      X_stage_(tree.nv) {
  resize();
}

void StageNodes::hold(PhaseRows* rows) {
  phase_ = rows;
  rows_ = fixed_ + (rows != nullptr ? rows->count() : 0);
  load_ = rows != nullptr ? rows->load() : nullptr;
  slides_ = rows != nullptr ? static_cast<int>(rows->slides().size()) : 0;
  rolling_ = 0;
  for (int r = 0; r < rows_ - fixed_; ++r) rolling_ += rows->by_rate(r) ? 1 : 0;
  varies_ = false;
  for (int j = 0; j < slides_; ++j) varies_ |= rows->friction_varies(j);
  nodes_[0].q.setConstant(std::numeric_limits<double>::quiet_NaN());  // its rows are other ones
  resize();
}

void StageNodes::resize() {
  const int nv = tree_->nv;
  for (Node& node : nodes_) {
    node.phi.setZero(rows_);
    node.rate.setZero(rows_);
    node.W.resize(nv, rows_);
    node.T.resize(nv, 2 * slides_);
    for (MatX* X : {&node.along, &node.across, &node.chart_across}) X->resize(nv, slides_);
    node.slip_across.setZero(slides_);
    node.drift.setZero(2 * slides_);
    node.pull.setZero(rows_);
  }
  if (lambda_.rows() != rows_ || lambda_.cols() != stages_ + 1) lambda_.setZero(rows_, stages_ + 1);
  angles_.setZero(slides_, stages_ + 1);
  slips_.setZero(slides_, stages_ + 1);
  friction_.resize(slides_, stages_ + 1);
  for (int j = 0; j < slides_; ++j) friction_.row(j).setConstant(phase_->slides()[static_cast<std::size_t>(j)].mu);
  if (rolling_ > 0) rolls_.assign(static_cast<std::size_t>(stages_), MatX(nv, rows_ - fixed_));
  roll_rates_.setZero(rows_ - fixed_, stages_);
}

void StageNodes::place(Node& node, int number) {
  if (fixed_ > 0) {
    contactvi::place(*tree_, node.q, node.at);
    evaluate_constraints(*tree_, node.at, node.q, node.t, node.phi.head(fixed_), node.W.leftCols(fixed_),
                         node.rate.head(fixed_), node.motions);
  }
  if (phase_ != nullptr)
    phase_->place(number, node.q, node.t,
                  {node.phi.tail(rows_ - fixed_), node.W.rightCols(rows_ - fixed_), node.T,
                   node.rate.tail(rows_ - fixed_), node.drift, node.pull.tail(rows_ - fixed_)});
  to_chart(node, node.W, node.chart_W);
  direct(node, number);
}

void StageNodes::direct(Node& node, int number) {
  node.F = node.W;
  if (slides_ == 0) {
    node.chart_F = node.chart_W;
    return;
  }
  for (int j = 0; j < slides_; ++j) {
    const int normal = phase_->slides()[static_cast<std::size_t>(j)].normal;
    const double c = std::cos(angles_(j, number)), s = std::sin(angles_(j, number));
    const auto t1 = node.T.col(2 * j), t2 = node.T.col(2 * j + 1);
    node.along.col(j) = c * t1 + s * t2;
    node.across.col(j) = c * t2 - s * t1;
    node.F.col(fixed_ + normal) -= friction_(j, number) * node.along.col(j);
  }
  to_chart(node, node.F, node.chart_F);
  to_chart(node, node.across, node.chart_across);
}

bool StageNodes::follow_slips(int from, int to) {
  if (!varies_) return false;
  slide_states_.clear();
  for (int k = from; k <= to; ++k)
    for (int j = 0; j < slides_; ++j) {
      if (!phase_->friction_varies(j)) continue;
      const double impulse = lambda_(fixed_ + phase_->slides()[static_cast<std::size_t>(j)].normal, k);
      slide_states_.push_back(
          {j, std::abs(slips_(j, k)), impulse / (h_ * table_->e[k]), t0_ + table_->d[k] * h_, &friction_(j, k)});
    }
  return phase_->set_friction(slide_states_);
}

void StageNodes::follow_forces() {
  if (slides_ == 0 || !phase_->friction_by_forces()) return;
  follow_slips(0, stages_ - 1);
  direct(nodes_[0], 0);
}

// Gradients by the chart at the start of the step.
void StageNodes::to_chart(const Node& node, const MatX& from, MatX& to) const {
  to = from;
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical) continue;
    const Mat3 J = so3_right_jacobian(node.X.segment<3>(joint.iv));
    to.middleRows<3>(joint.iv) = J.transpose() * from.middleRows<3>(joint.iv);
  }
}

void StageNodes::begin(StepEquations& equations, const VecCRef& q0, const VecCRef& p0, double t0, double h,
                       const VecX& forces) {
  const bool same = q0_.size() == q0.size() && nodes_[0].q == q0 && nodes_[0].t == t0;
  const bool same_speed = same && p0_.size() == p0.size() && p0_ == p0;
  p0_ = p0;
  h_ = h;
  t0_ = t0;
  for (int k = 0; k <= stages_; ++k) {
    if (k > 0 || !same) nodes_[k].motions.forget();
    nodes_[k].t = t0 + table_->d[k] * h;
    lambda_.col(k) = h * table_->e[k] * forces;
  }
  if (same && (slides_ == 0 || same_speed)) {
    for (int k = 1; k <= stages_; ++k) angles_.col(k) = angles_.col(0);
    return;
  }
  q0_ = q0;
  nodes_[0].q = q0;
  nodes_[0].X.setZero();
  place(nodes_[0], 0);
  if (slides_ == 0) return;
  if (!equations.node_velocity(q0, p0, v0_)) v0_.setZero();
  for (int j = 0; j < slides_; ++j) {
    const Eigen::Vector2d slip = nodes_[0].T.middleCols<2>(2 * j).transpose() * v0_ + nodes_[0].drift.segment<2>(2 * j);
    angles_.row(j).setConstant(phase_->start_angle(j, slip, v0_.cwiseAbs().maxCoeff()));
    slips_.row(j).setConstant(slip.dot(Eigen::Vector2d(std::cos(angles_(j, 0)), std::sin(angles_(j, 0)))));
  }
  follow_slips(0, stages_);
  direct(nodes_[0], 0);
}

void StageNodes::place(const Stages& stages) {
  const int S = stages.padded(), nv = tree_->nv;
  for (int k = 1; k <= stages_; ++k) {
    Node& node = nodes_[k];
    for (int d = 0; d < nv; ++d) {
      const double* rate = stages.rate() + static_cast<std::size_t>(d) * S;
      double sum = 0.0;
      for (int j = 0; j < stages_; ++j) sum += table_->to_node[k][j] * rate[j];
      node.X[d] = h_ * sum;
    }
    integrate(*tree_, q0_, node.X, 1.0, node.q);
    place(node, k);
    // What the rows of the phase are off at the start goes within the step, smoothly.
    const double d = table_->d[k], left = (1.0 - d) * (1.0 - d) * (1.0 + 2.0 * d);
    node.phi.tail(rows_ - fixed_) -= left * nodes_[0].phi.tail(rows_ - fixed_);
  }
  if (rolling_ > 0) place_rates(stages);
}

// The rows of velocities where the stages are.
void StageNodes::place_rates(const Stages& stages) {
  const int S = stages.padded();
  const GaussTable& table = stages.table();
  MatX none(tree_->nv, 2 * slides_);
  VecX no_drift(2 * slides_), no_pull(rows_ - fixed_);
  phi_.resize(rows_ - fixed_);
  for (int i = 0; i < stages_; ++i) {
    for (int d = 0; d < tree_->nv; ++d) {
      const double* rate = stages.rate() + static_cast<std::size_t>(d) * S;
      double sum = 0.0;
      for (int j = 0; j < stages_; ++j) sum += table.A[i][j] * rate[j];
      X_stage_[d] = h_ * sum;
    }
    integrate(*tree_, q0_, X_stage_, 1.0, q_stage_);
    phase_->place(stages_ + 1 + i, q_stage_, t0_ + table.c[i] * h_,
                  {phi_, rolls_[static_cast<std::size_t>(i)], none, roll_rates_.col(i), no_drift, no_pull});
  }
}

void StageNodes::impulse_at(int node, bool chart) {
  const Node& at = nodes_[node];
  impulse_.noalias() = (chart ? at.chart_F : at.F) * lambda_.col(node);
  if (phase_ != nullptr && phase_->any_adheres())
    impulse_.noalias() -= (h_ * table_->e[node]) * ((chart ? at.chart_W : at.W) * at.pull);
  if (load_ == nullptr) return;
  const double weight = h_ * table_->e[node];
  impulse_ += weight * *load_;
  if (!chart) return;
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical) continue;
    const Vec3 own = load_->segment<3>(joint.iv);
    impulse_.segment<3>(joint.iv) += weight * (so3_right_jacobian(at.X.segment<3>(joint.iv)).transpose() * own - own);
  }
}

void StageNodes::add_impulses() {
  p_start_ = p0_;
  for (int k = 0; k < stages_; ++k) {
    impulse_at(k, false);
    for (const Joint& joint : tree_->joints) {
      if (joint.type != JointType::kSpherical) continue;
      const Vec3 own = impulse_.segment<3>(joint.iv);
      impulse_.segment<3>(joint.iv) = so3_exp(nodes_[k].X.segment<3>(joint.iv)) * own;
    }
    p_start_ += impulse_;
  }
}

// With friction along slips of several directions.
bool StageNodes::forces_exceed_rows() const {
  const auto rank = [](MatX columns) {
    for (Eigen::Index r = 0; r < columns.cols(); ++r)
      if (const double size = columns.col(r).norm(); size > 0.0) columns.col(r) /= size;
    Eigen::ColPivHouseholderQR<MatX> factor;
    factor.setThreshold(kSameDirection);
    factor.compute(columns);
    return factor.rank();
  };
  for (const Node* node : {&nodes_.front(), &nodes_.back()})
    if (rank(node->F) > rank(node->W)) return true;
  return false;
}

}  // namespace contactvi

#include "step/stage_constraints.hpp"

#include <algorithm>
#include <cmath>

#include "model/constraint_check.hpp"
#include "model/constraints.hpp"
#include "step/ball_chart.hpp"
#include "step/projection.hpp"

namespace contactvi {

namespace {
// Relative pivot of the scaled matrix of the impulses below which rows depend on each other.
constexpr double kRedundant = 1e-10;
// Of the coordinates, and 1 m or rad: by which residuals of constraints are off. A step divides it by its length, and
// conditions at s nodes multiply it by up to about s^2.
constexpr double kRounding = 1e-15;
constexpr double kTurns = 1e-15;       // [rad] to which the charts of spherical joints belong to their velocities
constexpr double kIndependent = 1e-7;  // relative pivot above which no such row is looked for
constexpr double kZeroRow = 1e-20;     // share of the largest diagonal below which a row is rounding
}  // namespace

StageConstraints::Node::Node(const Tree& tree)
    : q(tree.nq),
      X(VecX::Zero(tree.nv)),
      phi(tree.elements.constraint_rows),
      rate(tree.elements.constraint_rows),
      W(tree.nv, tree.elements.constraint_rows),
      at(tree) {}

StageConstraints::StageConstraints(const Tree& tree, int stages)
    : tree_(&tree),
      table_(&lobatto_table(stages)),
      rows_(tree.elements.constraint_rows),
      stages_(stages),
      nodes_(stages + 1, Node(tree)),
      lambda_(MatX::Zero(rows_, stages + 1)),
      to_nodes_(stages, stages),
      kept_(0),
      changed_(0) {
  for (int k = 0; k < stages; ++k)
    for (int j = 0; j < stages; ++j) to_nodes_(j, k) = table_->to_node[k + 1][j];
  forget();
}

void StageConstraints::place(Node& node) {
  contactvi::place(*tree_, node.q, node.at);
  evaluate_constraints(*tree_, node.at, node.q, node.t, node.phi, node.W, node.rate);
  node.chart = node.W;
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical) continue;
    const Mat3 J = so3_right_jacobian(node.X.segment<3>(joint.iv));
    node.chart.middleRows<3>(joint.iv) = J.transpose() * node.W.middleRows<3>(joint.iv);
  }
}

void StageConstraints::begin(const VecCRef& q0, const VecCRef& p0, double t0, double h) {
  p0_ = p0;
  const bool same = q0_.size() == q0.size() && q0_ == q0 && nodes_[0].t == t0;
  h_ = h;
  for (int k = 0; k <= stages_; ++k) {
    nodes_[k].t = t0 + table_->d[k] * h;
    lambda_.col(k) = h * table_->e[k] * forces_;
  }
  violated_ = -1;
  if (same) return;
  q0_ = q0;
  nodes_[0].q = q0;
  place(nodes_[0]);
}

void StageConstraints::place_nodes(Stages& stages) {
  const int S = stages.padded(), nv = tree_->nv;
  stages.settle_turns(kTurns);
  for (int k = 1; k <= stages_; ++k) {
    Node& node = nodes_[k];
    for (int d = 0; d < nv; ++d) {
      const double* rate = stages.rate() + static_cast<std::size_t>(d) * S;
      double sum = 0.0;
      for (int j = 0; j < stages_; ++j) sum += table_->to_node[k][j] * rate[j];
      node.X[d] = h_ * sum;
    }
    integrate(*tree_, q0_, node.X, 1.0, node.q);
    place(node);
  }
  add_impulses();
  double* given = stages.impulse();
  std::fill_n(given, static_cast<std::size_t>(nv) * S, 0.0);
  for (int k = 1; k < stages_; ++k) {  // the share of the first one in all stages is that in the end
    impulse_.noalias() = nodes_[k].chart * lambda_.col(k);
    for (int d = 0; d < nv; ++d)
      for (int i = 0; i < S; ++i)
        given[static_cast<std::size_t>(d) * S + i] += (table_->share[std::min(i, stages_ - 1)][k] - 1.0) * impulse_[d];
  }
  stages.start_from(p_start_);
}

// The start momentum with all impulses but the last one; on spherical joints in the frame of the start.
void StageConstraints::add_impulses() {
  p_start_ = p0_;
  for (int k = 0; k < stages_; ++k) {
    impulse_.noalias() = nodes_[k].W * lambda_.col(k);
    for (const Joint& joint : tree_->joints) {
      if (joint.type != JointType::kSpherical) continue;
      const Vec3 own = impulse_.segment<3>(joint.iv);
      impulse_.segment<3>(joint.iv) = so3_exp(nodes_[k].X.segment<3>(joint.iv)) * own;
    }
    p_start_ += impulse_;
  }
}

// The charts of spherical joints where the stages are.
void StageConstraints::set_charts(const Stages& stages) {
  const int S = stages.padded();
  charts_.clear();
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical) continue;
    for (int i = 0; i < S; ++i) {
      const double* X = stages.X() + static_cast<std::size_t>(joint.iv) * S + i;
      charts_.push_back(so3_right_jacobian_inverse(Vec3(X[0], X[S], X[2 * S])));
    }
  }
}

// On spherical joints, x (nv, S): from the chart's momentum at the stages to the momentum, or from velocities to those
// in the chart (transposed).
void StageConstraints::to_stages(bool transposed, int S, double* x) const {
  std::size_t chart = 0;
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical) continue;
    for (int i = 0; i < S; ++i) {
      const Mat3& J = charts_[chart++];
      double* at = x + static_cast<std::size_t>(joint.iv) * S + i;
      const Vec3 y(at[0], at[S], at[2 * S]), z = transposed ? Vec3(J * y) : Vec3(J.transpose() * y);
      for (int a = 0; a < 3; ++a) at[a * S] = z[a];
    }
  }
}

// Of chart velocities x (nv, S) at the stages: what they move the rows at all nodes but the first one, (s m,).
void StageConstraints::move_rows(const double* x, int S, VecRef moved) {
  const Eigen::Map<const MatX> rates(x, S, tree_->nv);
  displaced_.noalias() = rates.topRows(stages_).transpose() * to_nodes_;
  for (int k = 1; k <= stages_; ++k)
    moved.segment((k - 1) * rows_, rows_).noalias() = h_ * (nodes_[k].chart.transpose() * displaced_.col(k - 1));
}

void StageConstraints::make_matrix(Stages& stages, StiffTerms& stiff) {
  const int S = stages.padded(), nv = tree_->nv, count = rows_ * stages_;
  const std::size_t size = static_cast<std::size_t>(nv) * S;
  if (given_.empty()) {
    for (int k = 0; k < count; ++k) {
      given_.emplace_back(size);
      moved_.emplace_back(size);
    }
    kept_ = AlignedArray(size);
    changed_ = AlignedArray(size);
  }
  std::copy_n(stages.dv(), size, kept_.data());
  matrix_.resize(count, count);
  scale_.resize(count);
  for (int l = 0; l < stages_; ++l)
    for (int c = 0; c < rows_; ++c) {
      const int column = l * rows_ + c;
      double* given = given_[column].data();
      for (int d = 0; d < nv; ++d) std::fill_n(given + static_cast<std::size_t>(d) * S, S, nodes_[l].chart(d, c));
      to_stages(false, S, given);
      std::copy_n(given, size, stages.dv());
      stages.solve();
      if (stiff.any()) stiff.correct_solution(stages, false);
      std::copy_n(stages.dv(), size, moved_[column].data());
    }
  for (int l = 0; l < stages_; ++l)
    for (int c = 0; c < rows_; ++c) {
      const int column = l * rows_ + c;
      std::copy_n(moved_[column].data(), size, changed_.data());
      to_stages(true, S, changed_.data());
      for (int d = 0; d < nv; ++d)
        for (int j = 0; j < stages_; ++j) changed_.data()[static_cast<std::size_t>(d) * S + j] *= table_->share[j][l];
      move_rows(changed_.data(), S, matrix_.col(column));
    }
  std::copy_n(kept_.data(), size, stages.dv());
  // Rows and columns of the same constraint have the same scale: that of its own mobility.
  VecX own(rows_);
  for (int c = 0; c < rows_; ++c) {
    own[c] = 0.0;
    for (int d = 0; d < nv; ++d)
      own[c] += given_[c].data()[static_cast<std::size_t>(d) * S] * moved_[c].data()[static_cast<std::size_t>(d) * S];
  }
  const double zero = kZeroRow * own.maxCoeff();
  const double noise = kRounding * (1.0 + q0_.cwiseAbs().maxCoeff()) * stages_ * stages_ / h_;
  rounding_ = 0.0;
  for (int c = 0; c < rows_; ++c) rounding_ += own[c] > zero ? noise * noise / own[c] : 0.0;
  for (int column = 0; column < count; ++column) {
    const double mobility = own[column % rows_];
    scale_[column] = mobility > zero ? 1.0 / std::sqrt(mobility) : 0.0;
  }
  matrix_ = scale_.asDiagonal() * matrix_ * scale_.asDiagonal() / h_;
  factor_matrix();
}

// Rows that do nothing are left out. The others depend on each other seldom enough for the cheaper factor to be tried
// first.
void StageConstraints::factor_matrix() {
  used_.clear();
  for (int k = 0; k < scale_.size(); ++k)
    if (scale_[k] > 0.0) used_.push_back(k);
  used_matrix_ = matrix_(used_, used_);
  redundant_ = false;
  if (used_.empty()) return;
  lu_.compute(used_matrix_);
  const auto pivots = lu_.matrixLU().diagonal().cwiseAbs();
  redundant_ = !(pivots.minCoeff() > kIndependent * pivots.maxCoeff());
  if (!redundant_) return;
  factor_.setThreshold(kRedundant);
  factor_.compute(used_matrix_);
}

// Sets the change of the impulses that takes the residuals away.
void StageConstraints::solve_impulses() {
  change_.setZero(residual_.size());
  if (used_.empty()) return;
  const VecX right = -(scale_.cwiseProduct(residual_) / h_)(used_);
  change_(used_) = redundant_ ? VecX(factor_.solve(right)) : VecX(lu_.solve(right));
  change_.array() *= scale_.array();
}

void StageConstraints::correct(Stages& stages, StiffTerms& stiff, bool factor) {
  const int S = stages.padded(), nv = tree_->nv, count = rows_ * stages_;
  const std::size_t size = static_cast<std::size_t>(nv) * S;
  set_charts(stages);
  if (factor || given_.empty()) make_matrix(stages, stiff);
  std::copy_n(stages.dv(), size, changed_.data());
  to_stages(true, S, changed_.data());
  residual_.resize(count);
  move_rows(changed_.data(), S, residual_);
  for (int k = 1; k <= stages_; ++k) residual_.segment((k - 1) * rows_, rows_) += nodes_[k].phi;
  solve_impulses();
  for (int l = 0; l < stages_; ++l) lambda_.col(l) += change_.segment(l * rows_, rows_);
  add_impulses();
  // With the impulses' change k of the momenta the correction is D^-1 (r + k), its energy r.dv + 2 k.dv + k.D^-1 k.
  double errors[kMaxStages];
  for (int i = 0; i < stages_; ++i) errors[i] = stages.error(i);
  for (int d = 0; d < nv; ++d)
    for (int i = 0; i < S; ++i) {
      const int stage = std::min(i, stages_ - 1);
      const std::size_t at = static_cast<std::size_t>(d) * S + i;
      double push = 0.0, moved = 0.0;
      for (int l = 0; l < stages_; ++l)
        for (int c = 0; c < rows_; ++c) {
          const int column = l * rows_ + c;
          const double weight = table_->share[stage][l] * change_[column];
          push += weight * given_[column].data()[at];
          moved += weight * moved_[column].data()[at];
        }
      if (i < stages_) errors[i] += push * (2.0 * stages.dv()[at] + moved);
      stages.dv()[at] += moved;
      stages.v()[at] += moved;
    }
  for (int i = 0; i < stages_; ++i) stages.set_error(i, errors[i]);
}

void StageConstraints::give_up() {
  const VecX& phi = nodes_[stages_].phi;
  if (!phi.allFinite()) return;
  double worst = 0.0;
  for (std::size_t i = 0; i < tree_->elements.constraints.size(); ++i) {
    const Constraint& c = tree_->elements.constraints[i];
    const double off = phi.segment(c.row, c.rows).norm();
    if (off <= worst) continue;
    worst = off;
    violated_ = static_cast<int>(i);
  }
}

bool StageConstraints::close(StepEquations& equations, const Stages& stages, const VecCRef& q1, VecRef p1) {
  Node& end = nodes_[stages_];
  end.q = q1;
  place(end);
  equations.place_node(q1);
  close_rates(equations, reduction_, end.W, end.rate, p1, v1_, lambda_.col(stages_));
  sum_ = lambda_.rowwise().sum();
  work_ = mean_work_ = 0.0;
  for (int k = 0; k <= stages_; ++k) {
    const double done = -lambda_.col(k).dot(nodes_[k].rate);
    work_ += done;
    mean_work_ += (1.0 - table_->d[k]) * done;
  }
  const Elements& elements = tree_->elements;
  const ConstraintErrors errors{nodes_[0].phi,
                                end.phi,
                                end.W.transpose() * v1_ + end.rate,
                                constraint_reach(end.q),
                                1.0 + v1_.cwiseAbs().maxCoeff() + end.rate.cwiseAbs().maxCoeff(),
                                0.0};
  violated_ = find_violated(elements, errors);
  if (violated_ >= 0) return false;
  VecX mean = VecX::Zero(tree_->nv);  // velocity of the step
  for (int d = 0; d < tree_->nv; ++d) mean[d] = stages.sum(stages.v(), d) / h_;
  MatX rates(rows_, stages_ + 1);
  for (int k = 0; k <= stages_; ++k) rates.col(k) = nodes_[k].rate;
  violated_ = find_jump(elements, end.W.transpose() * mean, rates, Eigen::Map<const VecX>(table_->e, stages_ + 1), h_);
  return violated_ < 0;
}

}  // namespace contactvi

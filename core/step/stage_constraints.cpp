#include "step/stage_constraints.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "model/constraint_check.hpp"
#include "model/constraints.hpp"
#include "step/ball_chart.hpp"
#include "step/projection.hpp"

namespace contactvi {

namespace {
// Of the coordinates, and 1 m or rad: by which residuals of constraints are off. A step divides it by its length, and
// conditions at s nodes multiply it by up to about s^2.
constexpr double kRounding = 1e-15;
constexpr double kTurns = 1e-15;    // [rad] to which the charts of spherical joints belong to their velocities
constexpr double kAlike = 1e-6;     // of unit vectors: directions of forces that differ by less are the same
constexpr double kZeroRow = 1e-20;  // share of the largest diagonal below which a row is rounding
// [m] to which the rows of a phase hold at the end of a step; and of the speeds, their rates.
constexpr double kHeld = 1e-11, kHeldRate = 1e-10;
constexpr int kMostTurns = 3;  // see find_slips
}  // namespace

StageConstraints::Node::Node(const Tree& tree) : q(tree.nq), X(VecX::Zero(tree.nv)), at(tree) {}

StageConstraints::StageConstraints(const Tree& tree, int stages)
    : tree_(&tree),
      table_(&lobatto_table(stages)),
      fixed_(tree.elements.constraint_rows),
      rows_(fixed_),
      stages_(stages),
      nodes_(stages + 1, Node(tree)),
      to_nodes_(stages, stages),
      at_nodes_(stages, stages),
      path_(tree, stages),
      stage_rates_(tree.nv, stages),
      v0_(tree.nv),
      q_stage_(tree.nq),
      X_stage_(tree.nv),
      v_node_(tree.nv),
      kept_(0),
      changed_(0),
      v1_(VecX::Zero(tree.nv)),
      q1_(tree.nq),
      p1_(tree.nv) {
  const GaussTable& gauss = gauss_table(stages);
  for (int k = 0; k < stages; ++k) {
    double P[kMaxStages];
    legendre(2.0 * table_->d[k + 1] - 1.0, stages, P);
    for (int j = 0; j < stages; ++j) {
      to_nodes_(j, k) = table_->to_node[k + 1][j];
      at_nodes_(j, k) = 0.0;
      for (int n = 0; n < stages; ++n) at_nodes_(j, k) += P[n] * gauss.to_legendre[n][j];
    }
  }
  resize();
  forget();
}

void StageConstraints::hold(PhaseRows* rows) {
  phase_ = rows;
  rows_ = fixed_ + (rows != nullptr ? rows->count() : 0);
  load_ = rows != nullptr ? rows->load() : nullptr;
  slides_ = rows != nullptr ? static_cast<int>(rows->slides().size()) : 0;
  rolling_ = 0;
  for (int r = 0; r < rows_ - fixed_; ++r) rolling_ += rows->by_rate(r) ? 1 : 0;
  nodes_[0].q.setConstant(std::numeric_limits<double>::quiet_NaN());  // its rows are other ones
  resize();
}

void StageConstraints::resize() {
  const int nv = tree_->nv;
  for (Node& node : nodes_) {
    node.phi.setZero(rows_);
    node.rate.setZero(rows_);
    node.W.resize(nv, rows_);
    node.T.resize(nv, 2 * slides_);
    for (MatX* X : {&node.along, &node.across, &node.chart_across}) X->resize(nv, slides_);
    node.slip_across.setZero(slides_);
  }
  if (lambda_.rows() != rows_) lambda_.setZero(rows_, stages_ + 1);
  angles_.setZero(slides_, stages_ + 1);
  slips_.setZero(slides_, stages_ + 1);
  answers_.setZero(slides_, stages_ + 1);
  turns_.assign(static_cast<std::size_t>(slides_ * (stages_ + 1)), 0);
  if (rolling_ > 0) rolls_.assign(static_cast<std::size_t>(stages_), MatX(nv, rows_ - fixed_));
}

// The node at which an unknown acts.
int StageConstraints::node_of(int unknown) const {
  return unknown < rows_ * stages_ ? unknown / rows_ : 1 + (unknown - rows_ * stages_) / slides_;
}

void StageConstraints::place(Node& node, int number) {
  if (fixed_ > 0) {
    contactvi::place(*tree_, node.q, node.at);
    evaluate_constraints(*tree_, node.at, node.q, node.t, node.phi.head(fixed_), node.W.leftCols(fixed_),
                         node.rate.head(fixed_));
  }
  if (phase_ != nullptr)
    phase_->place(number, node.q, node.phi.tail(rows_ - fixed_), node.W.rightCols(rows_ - fixed_), node.T);
  to_chart(node, node.W, node.chart_W);
  direct(node, number);
}

// The directions of the slips at a node, and what follows from them.
void StageConstraints::direct(Node& node, int number) {
  node.F = node.W;
  if (slides_ == 0) {
    node.chart_F = node.chart_W;
    return;
  }
  for (int j = 0; j < slides_; ++j) {
    const auto& [normal, mu] = phase_->slides()[static_cast<std::size_t>(j)];
    const double c = std::cos(angles_(j, number)), s = std::sin(angles_(j, number));
    const auto t1 = node.T.col(2 * j), t2 = node.T.col(2 * j + 1);
    node.along.col(j) = c * t1 + s * t2;
    node.across.col(j) = c * t2 - s * t1;
    node.F.col(fixed_ + normal) -= mu * node.along.col(j);
  }
  to_chart(node, node.F, node.chart_F);
  to_chart(node, node.across, node.chart_across);
}

// Gradients by the chart at the start of the step.
void StageConstraints::to_chart(const Node& node, const MatX& from, MatX& to) const {
  to = from;
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical) continue;
    const Mat3 J = so3_right_jacobian(node.X.segment<3>(joint.iv));
    to.middleRows<3>(joint.iv) = J.transpose() * from.middleRows<3>(joint.iv);
  }
}

void StageConstraints::begin(StepEquations& equations, const VecCRef& q0, const VecCRef& p0, double t0, double h) {
  const bool same = q0_.size() == q0.size() && nodes_[0].q == q0 && nodes_[0].t == t0;
  const bool same_speed = same && p0_.size() == p0.size() && p0_ == p0;
  p0_ = p0;
  h_ = h;
  knows_end_ = false;
  if (forces_.size() != rows_) forces_.setZero(rows_);
  for (int k = 0; k <= stages_; ++k) {
    nodes_[k].t = t0 + table_->d[k] * h;
    lambda_.col(k) = h * table_->e[k] * forces_;
  }
  violated_ = -1;
  std::fill(turns_.begin(), turns_.end(), 0);
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
    const Eigen::Vector2d slip = nodes_[0].T.middleCols<2>(2 * j).transpose() * v0_;
    angles_.row(j).setConstant(phase_->start_angle(j, slip, v0_.cwiseAbs().maxCoeff()));
    slips_.row(j).setConstant(slip.dot(Eigen::Vector2d(std::cos(angles_(j, 0)), std::sin(angles_(j, 0)))));
  }
  direct(nodes_[0], 0);
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
    place(node, k);
    // What the rows of the phase are off at the start goes within the step, smoothly.
    const double d = table_->d[k], left = (1.0 - d) * (1.0 - d) * (1.0 + 2.0 * d);
    node.phi.tail(rows_ - fixed_) -= left * nodes_[0].phi.tail(rows_ - fixed_);
  }
  if (rolling_ > 0) place_rates(stages);
  if (slides_ > 0) {
    for (int i = 0; i < stages_; ++i)
      for (int d = 0; d < nv; ++d) stage_rates_(d, i) = stages.rate()[static_cast<std::size_t>(d) * S + i];
    changed_turns_ = find_slips() || changed_turns_;
  }
  add_impulses();
  double* given = stages.impulse();
  std::fill_n(given, static_cast<std::size_t>(nv) * S, 0.0);
  for (int k = 1; k < stages_; ++k) {  // the share of the first one in all stages is that in the end
    impulse_at(k, true);
    for (int d = 0; d < nv; ++d)
      for (int i = 0; i < S; ++i)
        given[static_cast<std::size_t>(d) * S + i] += (table_->share[std::min(i, stages_ - 1)][k] - 1.0) * impulse_[d];
  }
  stages.start_from(p_start_);
}

// The rows of velocities where the stages are.
void StageConstraints::place_rates(const Stages& stages) {
  const int S = stages.padded();
  const GaussTable& table = stages.table();
  MatX none(tree_->nv, 2 * slides_);
  phi_.resize(rows_ - fixed_);
  for (int i = 0; i < stages_; ++i) {
    for (int d = 0; d < tree_->nv; ++d) {
      const double* rate = stages.rate() + static_cast<std::size_t>(d) * S;
      double sum = 0.0;
      for (int j = 0; j < stages_; ++j) sum += table.A[i][j] * rate[j];
      X_stage_[d] = h_ * sum;
    }
    integrate(*tree_, q0_, X_stage_, 1.0, q_stage_);
    phase_->place(stages_ + 1 + i, q_stage_, phi_, rolls_[static_cast<std::size_t>(i)], none);
  }
}

// The slips at the nodes inside of the step, of the path raised by the velocities at its ends. Whether one of them is
// found to have turned back that had not before, or the other way round.
bool StageConstraints::find_slips() {
  path_.set(q0_, h_, stage_rates_);
  if (knows_end_) path_.raise(v0_, v1_);
  bool any = false;
  for (int k = 1; k < stages_; ++k) {
    path_.velocity(table_->d[k], v_node_);
    slips_.col(k) = nodes_[k].along.transpose() * v_node_;
    nodes_[k].slip_across = nodes_[k].across.transpose() * v_node_;
    for (int j = 0; j < slides_; ++j) {
      // The first iterations may show a slip that has turned back and has not; what is seen a second time stays.
      int& seen = turns_[static_cast<std::size_t>(k * slides_ + j)];
      const bool back = slips_(j, k) < SlipProjection::kTurned * answers_(j, k);
      if (back == (seen % 2 == 1) || seen >= kMostTurns) continue;
      ++seen;
      any = true;
    }
  }
  return any;
}

// Sets impulse_ to what acts at a node.
void StageConstraints::impulse_at(int node, bool chart) {
  const Node& at = nodes_[node];
  impulse_.noalias() = (chart ? at.chart_F : at.F) * lambda_.col(node);
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

// The start momentum with all impulses but the last one; on spherical joints in the frame of the start.
void StageConstraints::add_impulses() {
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

// Of velocities x (nv, S) at the stages, which are changed: how they move the rows at all nodes but the first one, with
// those of velocities at the stages, over the step, and the directions of slips; (unknowns,).
void StageConstraints::move_rows(double* x, int S, VecRef moved) {
  const Eigen::Map<const MatX> rates(x, S, tree_->nv);
  const int held = rows_ - fixed_;
  if (rolling_ > 0)
    for (int i = 0; i < stages_; ++i)
      for (int r = 0; r < held; ++r)
        if (phase_->by_rate(r))
          moved[unknown_at(i, fixed_ + r)] = h_ * rates.row(i).dot(rolls_[static_cast<std::size_t>(i)].col(r));
  to_stages(true, S, x);
  displaced_.noalias() = rates.topRows(stages_).transpose() * to_nodes_;
  for (int k = 1; k <= stages_; ++k) {
    if (rolling_ == 0) {
      moved.segment((k - 1) * rows_, rows_).noalias() = h_ * (nodes_[k].chart_W.transpose() * displaced_.col(k - 1));
      continue;
    }
    for (int r = 0; r < rows_; ++r)
      if (r < fixed_ || !phase_->by_rate(r - fixed_))
        moved[unknown_at(k - 1, r)] = h_ * nodes_[k].chart_W.col(r).dot(displaced_.col(k - 1));
  }
  if (slides_ == 0 || stages_ == 1) return;
  displaced_.noalias() = rates.topRows(stages_).transpose() * at_nodes_;
  for (int k = 1; k < stages_; ++k)
    moved.segment(direction_at(k, 0), slides_).noalias() =
        h_ * (nodes_[k].chart_across.transpose() * displaced_.col(k - 1));
}

void StageConstraints::make_matrix(Stages& stages, StiffTerms& stiff) {
  const int S = stages.padded(), nv = tree_->nv, count = unknowns();
  const std::size_t size = static_cast<std::size_t>(nv) * S;
  if (static_cast<int>(given_.size()) != count) {
    given_.clear();
    moved_.clear();
    for (int k = 0; k < count; ++k) {
      given_.emplace_back(size);
      moved_.emplace_back(size);
    }
    kept_ = AlignedArray(size);
    changed_ = AlignedArray(size);
  }
  std::copy_n(stages.dv(), size, kept_.data());
  matrix_.resize(count, count);
  for (int column = 0; column < count; ++column) {
    double* given = given_[column].data();
    const int k = node_of(column);
    if (column < rows_ * stages_) {
      for (int d = 0; d < nv; ++d)
        std::fill_n(given + static_cast<std::size_t>(d) * S, S, nodes_[k].chart_F(d, column % rows_));
    } else {
      const int j = (column - rows_ * stages_) % slides_;
      const auto& [normal, mu] = phase_->slides()[static_cast<std::size_t>(j)];
      const double friction = mu * lambda_(fixed_ + normal, k);
      for (int d = 0; d < nv; ++d)
        std::fill_n(given + static_cast<std::size_t>(d) * S, S, -friction * nodes_[k].chart_across(d, j));
    }
    to_stages(false, S, given);
    std::copy_n(given, size, stages.dv());
    stages.solve();
    if (stiff.any()) stiff.correct_solution(stages, false);
    std::copy_n(stages.dv(), size, moved_[column].data());
  }
  for (int column = 0; column < count; ++column) {
    const int l = node_of(column);
    for (int d = 0; d < nv; ++d)
      for (int j = 0; j < S; ++j)
        changed_.data()[static_cast<std::size_t>(d) * S + j] =
            moved_[column].data()[static_cast<std::size_t>(d) * S + j] * table_->share[std::min(j, stages_ - 1)][l];
    move_rows(changed_.data(), S, matrix_.col(column));
  }
  std::copy_n(kept_.data(), size, stages.dv());
  for (int k = 1; k < stages_; ++k)
    for (int j = 0; j < slides_; ++j) {
      const int at = direction_at(k, j);
      answers_(j, k) = std::min(0.0, matrix_(at, at) / h_);
      if (turned(k, j)) {
        matrix_.row(at).setZero();
        matrix_(at, at) = h_;
        if (k > 1) matrix_(at, direction_at(k - 1, j)) = -h_;
      } else {
        matrix_(at, at) -= h_ * slips_(j, k);
      }
    }
  scale_matrix(S);
  system_.set(matrix_, row_scale_, scale_);
}

// Rows and columns of the impulses of one row have the same scale: that of its own mobility. Directions have the scale
// of what they do.
void StageConstraints::scale_matrix(int S) {
  const int count = unknowns();
  VecX own(rows_);
  for (int c = 0; c < rows_; ++c) {
    own[c] = 0.0;
    for (int d = 0; d < tree_->nv; ++d)
      own[c] += given_[c].data()[static_cast<std::size_t>(d) * S] * moved_[c].data()[static_cast<std::size_t>(d) * S];
  }
  const double zero = kZeroRow * (rows_ > 0 ? own.maxCoeff() : 0.0);
  // Least impulses of contacts that share a load are least in N s.
  const double common = rows_ > fixed_ ? own.tail(rows_ - fixed_).maxCoeff() : 0.0;
  const double noise = kRounding * (1.0 + q0_.cwiseAbs().maxCoeff()) * stages_ * stages_ / h_;
  rounding_ = 0.0;
  for (int c = 0; c < rows_; ++c) rounding_ += own[c] > zero ? noise * noise / own[c] : 0.0;
  matrix_ /= h_;
  scale_.resize(count);
  row_scale_.resize(count);
  for (int column = 0; column < rows_ * stages_; ++column) {
    const int row = column % rows_;
    const double mobility = row < fixed_ || !(own[row] > zero) ? own[row] : common;
    row_scale_[column] = scale_[column] = mobility > zero ? 1.0 / std::sqrt(mobility) : 0.0;
  }
  for (int column = rows_ * stages_; column < count; ++column) {
    const double largest = matrix_.col(column).cwiseAbs().maxCoeff();
    row_scale_[column] = common > 0.0 ? 1.0 / std::sqrt(common) : 1.0;
    scale_[column] = largest > 0.0 ? 1.0 / (row_scale_[column] * largest) : 0.0;
  }
}

// Impulses that change no row's velocity are those whose forces do nothing where the dependences of the forces are
// those of the rows; with friction along slips of several directions they may do something.
bool StageConstraints::slides_share_load() const {
  if (!system_.is_redundant() || slides_ == 0) return false;
  const auto rank = [](MatX columns) {
    for (Eigen::Index r = 0; r < columns.cols(); ++r)
      if (const double size = columns.col(r).norm(); size > 0.0) columns.col(r) /= size;
    Eigen::ColPivHouseholderQR<MatX> factor;
    factor.setThreshold(kAlike);
    factor.compute(columns);
    return factor.rank();
  };
  for (const Node* node : {&nodes_.front(), &nodes_.back()})
    if (rank(node->F) > rank(node->W)) return true;
  return false;
}

// Besides what the correction moves, which is in it.
void StageConstraints::add_to_residual(const Stages& stages) {
  const int S = stages.padded(), held = rows_ - fixed_;
  for (int k = 1; k <= stages_; ++k)
    for (int r = 0; r < rows_; ++r)
      if (r < fixed_ || !phase_->by_rate(r - fixed_)) residual_[unknown_at(k - 1, r)] += nodes_[k].phi[r];
  if (rolling_ > 0) {
    const Eigen::Map<const MatX> v(stages.v(), S, tree_->nv);
    for (int i = 0; i < stages_; ++i)
      for (int r = 0; r < held; ++r)
        if (phase_->by_rate(r))
          residual_[unknown_at(i, fixed_ + r)] = h_ * v.row(i).dot(rolls_[static_cast<std::size_t>(i)].col(r));
  }
  for (int k = 1; k < stages_; ++k)
    for (int j = 0; j < slides_; ++j) {
      double& residual = residual_[direction_at(k, j)];
      if (turned(k, j))
        residual = h_ * (angles_(j, k) - angles_(j, k - 1));
      else
        residual += h_ * nodes_[k].slip_across[j];
    }
}

void StageConstraints::correct(StepEquations& equations, Stages& stages, StiffTerms& stiff, bool factor) {
  const int S = stages.padded(), nv = tree_->nv, count = unknowns();
  if (count == 0) return;  // there are constant forces alone
  const std::size_t size = static_cast<std::size_t>(nv) * S;
  set_charts(stages);
  if (factor || changed_turns_ || static_cast<int>(given_.size()) != count) make_matrix(stages, stiff);
  changed_turns_ = false;
  std::copy_n(stages.dv(), size, changed_.data());
  residual_.resize(count);
  move_rows(changed_.data(), S, residual_);
  add_to_residual(stages);
  now_.setZero(count);  // where rows share a load the impulses are the least ones
  for (int k = 0; k < stages_; ++k) now_.segment(k * rows_, rows_) = lambda_.col(k);
  residual_ /= h_;
  system_.solve(residual_, now_, change_);
  // With the impulses' change k of the momenta the correction is D^-1 (r + k), its energy r.dv + 2 k.dv + k.D^-1 k.
  double errors[kMaxStages];
  for (int i = 0; i < stages_; ++i) errors[i] = stages.error(i);
  for (int d = 0; d < nv; ++d)
    for (int i = 0; i < S; ++i) {
      const int stage = std::min(i, stages_ - 1);
      const std::size_t at = static_cast<std::size_t>(d) * S + i;
      double push = 0.0, moved = 0.0;
      for (int column = 0; column < count; ++column) {
        const double weight = table_->share[stage][node_of(column)] * change_[column];
        push += weight * given_[column].data()[at];
        moved += weight * moved_[column].data()[at];
      }
      if (i < stages_) errors[i] += push * (2.0 * stages.dv()[at] + moved);
      stages.dv()[at] += moved;
      stages.v()[at] += moved;
    }
  for (int i = 0; i < stages_; ++i) stages.set_error(i, errors[i]);
  for (int l = 0; l < stages_; ++l) lambda_.col(l) += change_.segment(l * rows_, rows_);
  for (int k = 1; k < stages_ && slides_ > 0; ++k) {
    for (int j = 0; j < slides_; ++j)
      angles_(j, k) += std::clamp(change_[direction_at(k, j)], -SlipProjection::kFarTurn, SlipProjection::kFarTurn);
    direct(nodes_[k], k);
  }
  add_impulses();
  if (slides_ == 0 || stages_ == 1) return;
  equations.finish(q1_, p1_);
  if (load_ != nullptr) p1_ += h_ * table_->e[stages_] * *load_;
  equations.place_node(nodes_[stages_].q);
  knows_end_ = close_slides(equations, p1_);
}

// The impulse at the end where contacts slide, in momentum and velocity there.
bool StageConstraints::close_slides(StepEquations& equations, VecRef p1) {
  const Node& end = nodes_[stages_];
  return slip_projection_.apply(equations, end.W, end.T, end.rate, phase_->slides(), fixed_, angles_.col(stages_ - 1),
                                p1, v1_, lambda_.col(stages_), angles_.col(stages_), slips_.col(stages_));
}

void StageConstraints::give_up() {
  const auto phi = nodes_[stages_].phi.head(fixed_);
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

// Whether the rows of the phase hold at the end of the step.
bool StageConstraints::keeps_phase() const {
  const Node& end = nodes_[stages_];
  const double speed = 1.0 + v1_.cwiseAbs().maxCoeff();
  for (int r = fixed_; r < rows_; ++r) {
    if (!phase_->by_rate(r - fixed_) && !(std::abs(end.phi[r]) <= kHeld)) return false;
    if (!(std::abs(end.W.col(r).dot(v1_)) <= kHeldRate * speed)) return false;
  }
  return true;
}

bool StageConstraints::close(StepEquations& equations, const Stages& stages, const VecCRef& q1, VecRef p1) {
  Node& end = nodes_[stages_];
  end.q = q1;
  place(end, stages_);
  equations.place_node(q1);
  load_work_ = 0.0;
  if (load_ != nullptr) {
    p1 += h_ * table_->e[stages_] * *load_;
    for (int d = 0; d < tree_->nv; ++d) load_work_ += (*load_)[d] * stages.sum(stages.v(), d);
  }
  if (rows_ == 0) {
    v1_ = p1;
    equations.solve_mass(v1_);
  } else if (slides_ == 0) {
    close_rates(equations, reduction_, end.W, end.rate, p1, v1_, lambda_.col(stages_));
  } else if (!close_slides(equations, p1)) {
    return false;
  }
  direct(end, stages_);
  sum_ = lambda_.rowwise().sum();
  work_ = mean_work_ = 0.0;
  for (int k = 0; k <= stages_; ++k) {
    const double done = -lambda_.col(k).dot(nodes_[k].rate);
    work_ += done;
    mean_work_ += (1.0 - table_->d[k]) * done;
  }
  if (!keeps_phase()) return false;
  if (fixed_ == 0) return true;
  const Elements& elements = tree_->elements;
  const auto end_rates = end.W.leftCols(fixed_).transpose();
  const ConstraintErrors errors{nodes_[0].phi.head(fixed_),
                                end.phi.head(fixed_),
                                end_rates * v1_ + end.rate.head(fixed_),
                                constraint_reach(end.q),
                                1.0 + v1_.cwiseAbs().maxCoeff() + end.rate.cwiseAbs().maxCoeff(),
                                0.0};
  violated_ = find_violated(elements, errors);
  if (violated_ >= 0) return false;
  VecX mean = VecX::Zero(tree_->nv);  // velocity of the step
  for (int d = 0; d < tree_->nv; ++d) mean[d] = stages.sum(stages.v(), d) / h_;
  MatX rates(fixed_, stages_ + 1);
  for (int k = 0; k <= stages_; ++k) rates.col(k) = nodes_[k].rate.head(fixed_);
  violated_ = find_jump(elements, end_rates * mean, rates, Eigen::Map<const VecX>(table_->e, stages_ + 1), h_);
  return violated_ < 0;
}

}  // namespace contactvi

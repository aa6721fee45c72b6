#include "step/stage_constraints.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "model/constraint_check.hpp"
#include "model/constraints.hpp"
#include "model/coupling.hpp"
#include "step/ball_chart.hpp"
#include "step/projection.hpp"
#include "step/stage_iteration.hpp"

namespace contactvi {

namespace {
// Of the coordinates, and 1 m or rad: by which residuals of constraints are off. A step divides it by its length, and
// conditions at s nodes multiply it by up to about s^2.
constexpr double kRounding = 1e-15;
constexpr double kTurns = 1e-15;    // [rad] to which the charts of spherical joints belong to their velocities
constexpr double kZeroRow = 1e-20;  // share of the largest diagonal below which a row is rounding
// [m] to which the rows of a phase hold at the end of a step; and of the speeds, their rates.
constexpr double kHeld = 1e-11, kHeldRate = 1e-10;
constexpr int kMostTurns = 7;    // see find_slips
constexpr int kMostRounds = 40;  // of an impulse at the end and the coefficients of friction that depend on it
constexpr double kAimed = 1e-3;  // of the largest slip of a contact on a path: what is less may be an error of the path
constexpr double kAlike = 0.05;  // of the length of a step: a step that differs by less has nearly the same matrix
}  // namespace

StageConstraints::StageConstraints(const Tree& tree, int stages)
    : StageNodes(tree, stages),
      to_nodes_(stages, stages),
      raised_(stages),
      path_(tree, stages),
      stage_rates_(tree.nv, stages),
      v_node_(tree.nv),
      v1_(VecX::Zero(tree.nv)),
      q1_(tree.nq),
      p1_(tree.nv) {
  for (int k = 0; k < stages; ++k)
    for (int j = 0; j < stages; ++j) to_nodes_(j, k) = table_->to_node[k + 1][j];
  forget();
}

void StageConstraints::hold(PhaseRows* rows) {
  StageNodes::hold(rows);
  answers_.setZero(slides_, stages_ + 1);
  turns_.assign(static_cast<std::size_t>(slides_ * (stages_ + 1)), 0);
}

// The node at which an unknown acts.
int StageConstraints::node_of(int unknown) const {
  return unknown < rows_ * stages_ ? unknown / rows_ : 1 + (unknown - rows_ * stages_) / slides_;
}

void StageConstraints::begin(StepEquations& equations, const VecCRef& q0, const VecCRef& p0, double t0, double h,
                             const VecX& tau) {
  tau_ = &tau;
  knows_end_ = false;
  size_ = std::numeric_limits<double>::infinity();
  aims_ = slides_ > 0 && stages_ > 1;
  violated_ = -1;
  std::fill(turns_.begin(), turns_.end(), 0);
  if (forces_.size() != rows_) forces_.setZero(rows_);
  StageNodes::begin(equations, q0, p0, t0, h, forces_);
}

void StageConstraints::keep_start() {
  kept_lambda_ = lambda_;
  kept_angles_ = angles_;
  kept_turns_ = turns_;
  kept_end_ = knows_end_;
}

bool StageConstraints::start_again(double ratio) {
  if (ratio > 1.0 + kAlike) return false;
  const int n = stages_ + 1;
  MatX weights = MatX::Ones(n, n);  // column k: of the forces at the nodes in that at node k of this step
  for (int k = 0; k < n; ++k)
    for (int j = 0; j < n; ++j)
      for (int l = 0; l < n; ++l)
        if (l != j) weights(j, k) *= (ratio * table_->d[k] - table_->d[l]) / (table_->d[j] - table_->d[l]);
  const Eigen::Map<const VecX> e(table_->e, n);
  lambda_ = ratio * (kept_lambda_ * e.cwiseInverse().asDiagonal() * weights * e.asDiagonal());
  if (slides_ > 0) {
    const VecX start = angles_.col(0);
    angles_ = kept_angles_ * weights;
    angles_.col(0) = start;
  }
  aims_ = false;
  if (ratio < 1.0 - kAlike) return false;
  turns_ = kept_turns_;
  knows_end_ = kept_end_;
  return given_.cols() == unknowns();
}

void StageConstraints::place_nodes(Stages& stages) {
  const int S = stages.padded(), nv = tree_->nv;
  stages.settle_turns(kTurns);
  place(stages);
  if (slides_ > 0) {
    for (int i = 0; i < stages_; ++i)
      for (int d = 0; d < nv; ++d) stage_rates_(d, i) = stages.rate()[static_cast<std::size_t>(d) * S + i];
  }
  if (aims_) aim_slips();
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

// Slips begin the iterations along the velocities of the path to which the start values lead, unless they have come to
// rest on it or turned back.
void StageConstraints::aim_slips() {
  aims_ = false;
  path_.set(q0_, h_, stage_rates_);
  VecX v1(tree_->nv);
  path_.velocity(1.0, v1);
  path_.raise(v0_, v1);
  MatX slips(2 * slides_, stages_ + 1);
  for (int k = 0; k <= stages_; ++k) {
    path_.velocity(table_->d[k], v_node_);
    slips.col(k).noalias() = nodes_[k].T.transpose() * v_node_;
    slips.col(k) += nodes_[k].drift;
  }
  const VecX least = kAimed * slips.cwiseAbs().rowwise().maxCoeff();
  for (int k = 1; k <= stages_; ++k) {
    for (int j = 0; j < slides_; ++j) {
      const auto slip = slips.col(k).segment<2>(2 * j);
      const double c = std::cos(angles_(j, k - 1)), s = std::sin(angles_(j, k - 1));
      const double along = c * slip[0] + s * slip[1], across = c * slip[1] - s * slip[0];
      const bool goes_on = along > least.segment<2>(2 * j).maxCoeff();
      angles_(j, k) = angles_(j, k - 1) + (goes_on ? std::atan2(across, along) : 0.0);
    }
    direct(nodes_[k], k);
  }
}

// The velocity at the end as the stages stand, and by it the slips at the nodes inside of the step, of the path that it
// raises. Notes where one of them is found to have turned back that had not before, or the other way round.
void StageConstraints::find_slips(StepEquations& equations, Stages& stages) {
  if (slides_ == 0 || stages_ == 1) return;
  p1_ = p_start_;
  for (int d = 0; d < tree_->nv; ++d) p1_[d] += stages.sum(stages.G(), d);
  for (const Joint& joint : tree_->joints)
    if (joint.type == JointType::kSpherical) p1_.segment<3>(joint.iv) = stages.ball_end(joint, p_start_);
  fold_momentum(*tree_, p1_);
  if (load_ != nullptr) p1_ += h_ * table_->e[stages_] * *load_;
  add_end_pull(p1_);
  equations.place_node(nodes_[stages_].q);
  knows_end_ = close_slides(equations, p1_);
  path_.set(q0_, h_, stage_rates_);
  if (knows_end_) path_.raise(v0_, v1_);
  for (int k = 1; k < stages_; ++k) {
    path_.velocity(table_->d[k], v_node_);
    slips_.col(k) = nodes_[k].along.transpose() * v_node_;
    nodes_[k].slip_across = nodes_[k].across.transpose() * v_node_;
    for (int j = 0; j < slides_; ++j) {
      const double c = std::cos(angles_(j, k)), s = std::sin(angles_(j, k));
      const auto drift = nodes_[k].drift.segment<2>(2 * j);
      slips_(j, k) += c * drift[0] + s * drift[1];
      nodes_[k].slip_across[j] += c * drift[1] - s * drift[0];
      // The first iterations may show a slip that has turned back and has not. What changes on and on stays at last, so
      // that the iterations can end; where it is wrong the step is not taken (keeps_phase).
      int& seen = turns_[static_cast<std::size_t>(k * slides_ + j)];
      const bool back = slips_(j, k) < SlipProjection::kTurned * answers_(j, k);
      if (back == (seen % 2 == 1) || seen >= kMostTurns) continue;
      ++seen;
      changed_turns_ = true;
    }
  }
  follow_slips(1, stages_);
}

// The charts of spherical joints where the stages are.
void StageConstraints::set_charts(const Stages& stages) {
  const int S = stages.padded();
  charts_.clear();
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical) continue;
    for (int i = 0; i < stages_; ++i) {
      const double* X = stages.X() + static_cast<std::size_t>(joint.iv) * S + i;
      charts_.push_back(so3_right_jacobian_inverse(Vec3(X[0], X[S], X[2 * S])));
    }
  }
}

// Calls visit(first row of x, J_r^-1) for each spherical joint at each stage.
template <class Visit>
void StageConstraints::each_chart(Visit visit) const {
  std::size_t chart = 0;
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical) continue;
    for (int i = 0; i < stages_; ++i) visit(joint.iv * stages_ + i, charts_[chart++]);
  }
}

// From a panel of momenta of the stages in their charts to what these change of rates and velocities.
void StageConstraints::respond(const StagePanel& given, Stages& stages, StiffTerms& stiff, StagePanel& rates,
                               StagePanel& velocities) {
  if (coupled_) {
    response_->solve(given, rates);
    response_->velocities(rates, velocities);
    return;
  }
  const int S = stages.padded(), nv = tree_->nv;
  velocities = given;
  each_chart([&](int row, const Mat3& J) { turn(velocities, row, J.transpose()); });
  for (Eigen::Index c = 0; c < given.cols(); ++c) {
    for (int d = 0; d < nv; ++d)
      for (int i = 0; i < S; ++i)
        stages.dv()[static_cast<std::size_t>(d) * S + i] = velocities(d * stages_ + std::min(i, stages_ - 1), c);
    stages.solve();
    if (stiff.any()) stiff.correct_solution(stages, false);
    for (int d = 0; d < nv; ++d)
      for (int i = 0; i < stages_; ++i)
        velocities(d * stages_ + i, c) = stages.dv()[static_cast<std::size_t>(d) * S + i];
  }
  rates = velocities;
  each_chart([&](int row, const Mat3& J) { turn(rates, row, J); });
}

// The rows of a spherical joint at one stage of a panel, the first of which is given, by R.
void StageConstraints::turn(StagePanel& panel, int row, const Mat3& R) const {
  const int s = stages_;
  for (Eigen::Index c = 0; c < panel.cols(); ++c) {
    const Vec3 x = R * Vec3(panel(row, c), panel(row + s, c), panel(row + 2 * s, c));
    for (int a = 0; a < 3; ++a) panel(row + a * s, c) = x[a];
  }
}

// How changes of the stages' rates and velocities, and of the rates at the end (nv, columns), move the rows at all
// nodes but the first one, with those of velocities at the stages, over the step, and the slips across their
// directions; (unknowns, columns).
void StageConstraints::move_rows(const StagePanel& rates, const StagePanel& velocities, const MatX& end_rates,
                                 MatX& moved) {
  const int nv = tree_->nv, held = rows_ - fixed_;
  moved.resize(unknowns(), rates.cols());
  displaced_.resize(nv, rates.cols());
  const auto sum = [&](const auto& weights) {
    for (int d = 0; d < nv; ++d)
      displaced_.row(d).noalias() = h_ * (weights.transpose() * rates.middleRows(d * stages_, stages_));
  };
  for (int k = 1; k <= stages_; ++k) {
    sum(to_nodes_.col(k - 1));
    moved.middleRows((k - 1) * rows_, rows_).noalias() = nodes_[k].chart_W.transpose() * displaced_;
  }
  for (int i = 0; i < stages_ && rolling_ > 0; ++i)
    for (int r = 0; r < held; ++r) {
      if (!phase_->by_rate(r)) continue;
      auto rate = moved.row(unknown_at(i, fixed_ + r));
      rate.setZero();
      for (int d = 0; d < nv; ++d)
        rate += (h_ * rolls_[static_cast<std::size_t>(i)](d, r)) * velocities.row(d * stages_ + i);
    }
  if (slides_ == 0 || stages_ == 1) return;
  for (int k = 1; k < stages_; ++k) {
    sum((knows_end_ ? raised_.rate : raised_.plain).col(k - 1));
    if (knows_end_) displaced_ += (h_ * raised_.rate_by_end[k - 1]) * end_rates;
    moved.middleRows(direction_at(k, 0), slides_).noalias() = nodes_[k].chart_across.transpose() * displaced_;
  }
}

// The force of a unit of an unknown at its node, and the same in the chart.
void StageConstraints::force_of(int unknown, VecRef force, VecRef chart) const {
  const Node& node = nodes_[node_of(unknown)];
  if (unknown < rows_ * stages_) {
    force = node.F.col(unknown % rows_);
    chart = node.chart_F.col(unknown % rows_);
    return;
  }
  const int j = (unknown - rows_ * stages_) % slides_;
  const int normal = phase_->slides()[static_cast<std::size_t>(j)].normal;
  const double friction = friction_(j, node_of(unknown)) * lambda_(fixed_ + normal, node_of(unknown));
  force = -friction * node.across.col(j);
  chart = -friction * node.chart_across.col(j);
}

// Changes of the rates at the end by those of the stages and of the start momentum (in its axes), (nv, columns).
void StageConstraints::end_rates(StepEquations& equations, const StagePanel& rates, StagePanel& momenta, MatX& found) {
  found.resize(tree_->nv, rates.cols());
  if (slides_ == 0 || stages_ == 1 || !knows_end_) return;
  const Node& end = nodes_[stages_];
  if (coupled_) response_->end_momenta(rates, momenta);
  found = momenta;
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical || coupled_) continue;
    found.middleRows<3>(joint.iv) =
        so3_exp(Vec3(-end.X.segment<3>(joint.iv))).toRotationMatrix() * found.middleRows<3>(joint.iv);
  }
  slip_projection_.respond(equations, found);
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical) continue;
    found.middleRows<3>(joint.iv) =
        so3_right_jacobian_inverse(Vec3(end.X.segment<3>(joint.iv))) * found.middleRows<3>(joint.iv);
  }
}

void StageConstraints::make_matrix(StepEquations& equations, Stages& stages, StiffTerms& stiff) {
  const int nv = tree_->nv, count = unknowns();
  const Node& end = nodes_[stages_];
  given_.resize(nv * stages_, count);
  StagePanel momenta(nv, count);
  VecX force(nv), chart(nv);
  for (int column = 0; column < count; ++column) {
    const int k = node_of(column);
    force_of(column, force, chart);
    for (int d = 0; d < nv; ++d)
      for (int i = 0; i < stages_; ++i) given_(d * stages_ + i, column) = table_->share[i][k] * chart[d];
    for (const Joint& joint : tree_->joints) {
      if (joint.type != JointType::kSpherical) continue;
      // The start momentum has all of it in its axes, what of that a stage does not have is taken off in the chart.
      const Vec3 own = force.segment<3>(joint.iv), start = so3_exp(nodes_[k].X.segment<3>(joint.iv)) * own;
      const Vec3 less = so3_right_jacobian(Vec3(end.X.segment<3>(joint.iv))) * start - chart.segment<3>(joint.iv);
      force.segment<3>(joint.iv) = start;
      for (int a = 0; a < 3; ++a)
        for (int i = 0; i < stages_; ++i) given_((joint.iv + a) * stages_ + i, column) += less[a];
    }
    momenta.col(column) = force;
  }
  MatX ends;
  respond(given_, stages, stiff, rates_, velocities_);
  end_rates(equations, rates_, momenta, ends);
  move_rows(rates_, velocities_, ends, matrix_);
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
  scale_matrix();
  system_.set(matrix_, row_scale_, scale_);
}

// Rows and columns of the impulses of one row have the same scale: that of its own mobility. Directions have the scale
// of what they do.
void StageConstraints::scale_matrix() {
  const int count = unknowns();
  VecX own(rows_);
  for (int c = 0; c < rows_; ++c) {
    own[c] = 0.0;  // all stages have all of the impulse at the first node
    for (int d = 0; d < tree_->nv; ++d) own[c] += given_(d * stages_, c) * rates_(d * stages_, c);
  }
  const double zero = kZeroRow * (rows_ > 0 ? own.maxCoeff() : 0.0);
  // Least impulses of contacts that share a load are least in N s.
  const double common = rows_ > fixed_ ? own.tail(rows_ - fixed_).maxCoeff() : 0.0;
  const double noise = kRounding * (1.0 + q0_.cwiseAbs().maxCoeff()) * stages_ * stages_ / h_;
  rounding_ = impulse_rounding_ = 0.0;
  for (int c = 0; c < rows_; ++c) {
    if (!(own[c] > zero)) continue;
    rounding_ += noise * noise / own[c];
    impulse_rounding_ = std::max(impulse_rounding_, noise / own[c]);
  }
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
// those of the rows.
bool StageConstraints::slides_share_load() const {
  return system_.is_redundant() && slides_ > 0 && forces_exceed_rows();
}

// Besides what the correction moves, which is in it.
void StageConstraints::add_to_residual(const Stages& stages) {
  const int S = stages.padded(), held = rows_ - fixed_;
  for (int k = 1; k <= stages_; ++k)
    for (int r = 0; r < rows_; ++r)
      if (r < fixed_ || !phase_->by_rate(r - fixed_)) residual_[unknown_at(k - 1, r)] += nodes_[k].phi[r];
  if (rolling_ > 0) {
    const Eigen::Map<const MatX> v(stages.v(), S, tree_->nv), dv(stages.dv(), S, tree_->nv);
    for (int i = 0; i < stages_; ++i)
      for (int r = 0; r < held; ++r)
        if (phase_->by_rate(r))
          residual_[unknown_at(i, fixed_ + r)] +=
              h_ * ((v.row(i) - dv.row(i)).dot(rolls_[static_cast<std::size_t>(i)].col(r)) + roll_rates_(r, i));
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

// Newton's matrix, as the stages stand.
bool StageConstraints::couple(StepEquations& equations, const Stages& stages) {
  const int S = stages.padded(), nv = tree_->nv;
  if (!response_) response_ = std::make_unique<StageResponse>(*tree_, stages_);
  MatX v(nv, stages_);  // before the correction of the last iteration
  for (int d = 0; d < nv; ++d)
    for (int i = 0; i < stages_; ++i) {
      const std::size_t at = static_cast<std::size_t>(d) * S + i;
      v(d, i) = stages.v()[at] - stages.dv()[at];
    }
  return response_->take({q0_, p_start_, h_, *tau_, nodes_[0].t, equations.servo(), v});
}

void StageConstraints::correct(StepEquations& equations, Stages& stages, StiffTerms& stiff, bool factor) {
  const int S = stages.padded(), nv = tree_->nv, count = unknowns();
  if (count == 0) return;  // there are constant forces alone
  set_charts(stages);
  const bool known = knows_end_;
  find_slips(equations, stages);
  StagePanel left(nv * stages_, 1), kernel(nv * stages_, 1), base, base_velocities, none = StagePanel::Zero(nv, 1);
  bool again = factor || given_.cols() != count;
  for (int d = 0; d < nv; ++d)
    for (int i = 0; i < stages_; ++i) {
      const std::size_t at = static_cast<std::size_t>(d) * S + i;
      left(d * stages_ + i, 0) = stages.residual()[at];
      kernel(d * stages_ + i, 0) = stages.dv()[at];
    }
  const VecX found = kernel.col(0);
  base_velocities = kernel;
  each_chart([&](int row, const Mat3& J) {
    turn(left, row, J.inverse().transpose());
    turn(kernel, row, J);
  });
  again = again || changed_turns_ || known != knows_end_;
  if (again) size_ = std::numeric_limits<double>::infinity();
  if (again) coupled_ = stages_ > 1 && couple(equations, stages);
  if (coupled_)
    respond(left, stages, stiff, base, base_velocities);
  else
    base = kernel;
  if (again) make_matrix(equations, stages, stiff);
  changed_turns_ = false;
  MatX moved, ends;
  end_rates(equations, base, none, ends);
  move_rows(base, base_velocities, ends, moved);
  residual_ = moved.col(0);
  add_to_residual(stages);
  now_.setZero(count);  // where rows share a load the impulses are the least ones
  for (int k = 0; k < stages_; ++k) now_.segment(k * rows_, rows_) = lambda_.col(k);
  residual_ /= h_;
  system_.solve(residual_, now_, change_);
  // With the impulses' change k of the momenta the correction is x = D^-1 (r + k), its energy x.(r + k).
  const VecX push = left + given_ * change_, du = base + rates_ * change_, dv = base_velocities + velocities_ * change_;
  for (int i = 0; i < stages_; ++i) {
    double error = stages.error(i);
    for (int d = 0; d < nv; ++d) {
      const int at = d * stages_ + i;
      error += push[at] * du[at] - left(at, 0) * kernel(at, 0);
    }
    stages.set_error(i, error);
  }
  for (int d = 0; d < nv; ++d)
    for (int i = 0; i < S; ++i) {
      const std::size_t at = static_cast<std::size_t>(d) * S + i;
      const int row = d * stages_ + std::min(i, stages_ - 1);
      stages.v()[at] += dv[row] - found[row];
      stages.dv()[at] = dv[row];
    }
  for (int l = 0; l < stages_; ++l) lambda_.col(l) += change_.segment(l * rows_, rows_);
  for (int k = 1; k < stages_; ++k)
    for (int j = 0; j < slides_; ++j)
      angles_(j, k) += std::clamp(change_[direction_at(k, j)], -SlipProjection::kFarTurn, SlipProjection::kFarTurn);
  accelerate(stages, du, push);
  follow_forces();
  for (int k = 1; k < stages_ && slides_ > 0; ++k) direct(nodes_[k], k);
  add_impulses();
}

// Of stage velocities, impulses and directions together, by the corrections of the velocities.
void StageConstraints::accelerate(Stages& stages, const VecX& du, const VecX& push) {
  // What has not become much less is rounding, or belongs to another solution.
  const double size = std::abs(du.dot(push)), last = std::exchange(size_, size);
  if (std::isinf(last)) acceleration_.clear();
  if (!(size < StageIteration::kProgress * StageIteration::kProgress * last)) return acceleration_.clear();
  const int S = stages.padded(), nv = tree_->nv, s = stages_;
  VecX x((nv + rows_ + slides_) * s);
  for (int d = 0; d < nv; ++d) std::copy_n(stages.v() + static_cast<std::size_t>(d) * S, s, x.data() + d * s);
  Eigen::Map<MatX> lambda(x.data() + nv * s, rows_, s), angles(x.data() + nv * s + rows_ * s, slides_, s);
  lambda = lambda_.leftCols(s);
  angles = angles_.leftCols(s);
  acceleration_.apply(x, du, push);
  lambda_.leftCols(s) = lambda;
  angles_.leftCols(s) = angles;
  for (int d = 0; d < nv; ++d)
    for (int i = 0; i < S; ++i) stages.v()[static_cast<std::size_t>(d) * S + i] = x[d * s + std::min(i, s - 1)];
}

// The impulse at the end where contacts slide, in momentum and velocity there.
bool StageConstraints::close_slides(StepEquations& equations, VecRef p1) {
  const Node& end = nodes_[stages_];
  const auto apply = [&] {
    return slip_projection_.apply(equations, end.W, end.T, end.rate, end.drift, phase_->slides(), fixed_,
                                  friction_.col(stages_), angles_.col(stages_ - 1), p1, v1_, lambda_.col(stages_),
                                  angles_.col(stages_), slips_.col(stages_));
  };
  if (!phase_->friction_by_forces()) return apply();
  const VecX free = p1;
  for (int k = 0; k < kMostRounds; ++k) {
    p1 = free;
    if (!apply()) return false;
    if (!follow_slips(stages_, stages_)) return true;
  }
  return false;
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
    if (!(std::abs(end.W.col(r).dot(v1_) + end.rate[r]) <= kHeldRate * speed)) return false;
  }
  // Equations with the direction of another node for a slip that has not turned back have a solution, but not that one.
  for (int k = 1; k < stages_; ++k)
    for (int j = 0; j < slides_; ++j)
      if (turned(k, j) && slips_(j, k) > 0.0) return false;
  return true;
}

// The adhesion at the end of the step, in the momentum there.
void StageConstraints::add_end_pull(VecRef p) const {
  if (phase_ == nullptr || !phase_->any_adheres()) return;
  const Node& end = nodes_[static_cast<std::size_t>(stages_)];
  p.noalias() -= (h_ * table_->e[stages_]) * (end.W * end.pull);
}

// Work of the friction of sliding contacts on surfaces that move along themselves, at a node.
double StageConstraints::slide_work(int k) const {
  double work = 0.0;
  for (int j = 0; j < slides_; ++j) {
    const double friction = friction_(j, k) * lambda_(fixed_ + phase_->slides()[static_cast<std::size_t>(j)].normal, k);
    const Eigen::Vector2d d(std::cos(angles_(j, k)), std::sin(angles_(j, k)));
    work += friction * d.dot(nodes_[static_cast<std::size_t>(k)].drift.segment<2>(2 * j));
  }
  return work;
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
  add_end_pull(p1);
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
    const double done = -lambda_.col(k).dot(nodes_[k].rate) + slide_work(k);
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

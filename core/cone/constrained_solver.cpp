#include "cone/constrained_solver.hpp"

#include <algorithm>
#include <cmath>

#include "base/disjoint_sets.hpp"

namespace contactvi {

namespace {
constexpr double kRedundant = 1e-10;  // of the rows of equations, scaled to one: less is rounding
constexpr double kStill = 1e-11;      // of the speeds: slower is at rest
constexpr double kIdle = 1e-10;       // of a row of a contact: what equations leave of it is rounding
}  // namespace

void ConstrainedSolver::set_equations(const BlockProblem& problem, const Eigen::Ref<const MatX>& W) {
  equations_ = static_cast<int>(W.cols());
  if (!any()) return;
  find_groups(problem, W);
  reduced_.start = {0};
  reduced_.M.clear();
  for (Group& group : groups_) {
    find_basis(problem, W, group);
    const auto size = static_cast<int>(group.S.cols());
    group.first = reduced_.start.back();
    group.block = size > 0 ? reduced_.blocks() : -1;
    if (size == 0) continue;
    reduced_.start.push_back(group.first + size);
    reduced_.M.push_back(group.S.transpose() * group.MS);
    group.masses.compute(reduced_.M.back());
  }
}

// Blocks on which the same equation acts belong together.
void ConstrainedSolver::find_groups(const BlockProblem& problem, const Eigen::Ref<const MatX>& W) {
  DisjointSets sets(problem.blocks());
  std::vector<int> touched(equations_, -1);
  for (int e = 0; e < equations_; ++e)
    for (int b = 0; b < problem.blocks(); ++b) {
      if (W.col(e).segment(problem.start[b], problem.size(b)).isZero(0.0)) continue;
      if (touched[e] < 0)
        touched[e] = b;
      else
        sets.join(touched[e], b);
    }
  groups_.clear();
  group_of_.assign(problem.blocks(), -1);
  for (int b = 0; b < problem.blocks(); ++b) {
    int& group = group_of_[sets.root(b)];
    if (group < 0) {
      group = static_cast<int>(groups_.size());
      groups_.emplace_back();
    }
    group_of_[b] = group;
    groups_[group].blocks.push_back(b);
    for (int d = problem.start[b]; d < problem.start[b + 1]; ++d) groups_[group].dofs.push_back(d);
  }
  for (int e = 0; e < equations_; ++e)
    if (touched[e] >= 0) groups_[group_of_[touched[e]]].equations.push_back(e);
}

void ConstrainedSolver::find_basis(const BlockProblem& problem, const Eigen::Ref<const MatX>& W, Group& group) {
  const auto n = static_cast<Eigen::Index>(group.dofs.size()), m = static_cast<Eigen::Index>(group.equations.size());
  if (m == 0) {
    group.S.setIdentity(n, n);
  } else {
    MatX& rows = group.rows;
    rows.resize(n, m);
    group.scale.resize(m);
    for (Eigen::Index e = 0; e < m; ++e) {
      rows.col(e) = W.col(group.equations[e])(group.dofs);
      group.scale[e] = 1.0 / rows.col(e).norm();
      rows.col(e) *= group.scale[e];
    }
    group.W.setThreshold(kRedundant);
    group.W.compute(rows);
    group.S.setZero(n, n - group.W.rank());
    group.S.bottomRows(group.S.cols()).setIdentity();
    group.S.applyOnTheLeft(group.W.householderQ());
  }
  group.MS.resize(n, group.S.cols());
  Eigen::Index first = 0;
  for (int b : group.blocks) {
    const Eigen::Index size = problem.size(b);
    group.MS.middleRows(first, size).noalias() = problem.M[b] * group.S.middleRows(first, size);
    first += size;
  }
}

void ConstrainedSolver::project(const VecCRef& rate, VecRef v) const {
  for (const Group& group : groups_) {
    if (group.equations.empty()) continue;
    // The least change that satisfies the equations, and what of it the free velocities take back.
    const VecX start = v(group.dofs);
    const VecX missing = VecX(rate(group.equations)).cwiseProduct(group.scale) - group.rows.transpose() * start;
    VecX change = group.W.transpose().solve(missing);
    if (group.S.cols() > 0) change -= group.S * group.masses.solve(group.MS.transpose() * change);
    v(group.dofs) = start + change;
  }
}

VecX ConstrainedSolver::multipliers(const VecCRef& p) const {
  VecX mu = VecX::Zero(equations_);
  for (const Group& group : groups_)
    if (!group.equations.empty()) mu(group.equations) = group.W.solve(VecX(p(group.dofs))).cwiseProduct(group.scale);
  return mu;
}

// held_ and u_ of v.
void ConstrainedSolver::split(const VecCRef& v) {
  held_ = v;
  u_.resize(reduced_.start.back());
  for (const Group& group : groups_) {
    if (group.block < 0) continue;
    const VecX part = group.masses.solve(group.MS.transpose() * v(group.dofs));
    u_.segment(group.first, part.size()) = part;
    if (group.equations.empty())
      held_(group.dofs).setZero();
    else
      held_(group.dofs) -= group.S * part;
  }
}

void ConstrainedSolver::join(VecRef v) const {
  v = held_;
  for (const Group& group : groups_)
    if (group.block >= 0) v(group.dofs) += group.S * u_.segment(group.first, group.S.cols());
}

// A contact whose normal moves nothing that is free has no part in the problem, nor has joint friction of that kind.
void ConstrainedSolver::add_contact(const BlockProblem& problem, int i) {
  const BlockContact& c = problem.contacts[i];
  int used[2] = {-1, -1};
  MatX rows[2];
  double whole = 0.0, left = 0.0;  // squares of the first row
  const double* coefficients = problem.W.data() + c.column;
  for (int block : {c.a, c.b}) {
    if (block < 0) continue;
    const Group& group = groups_[group_of_[block]];
    const int side = used[0] < 0 || used[0] == group_of_[block] ? 0 : 1, n = problem.size(block);
    Eigen::Index first = 0;
    for (std::size_t k = 0; group.blocks[k] != block; ++k) first += problem.size(group.blocks[k]);
    const Eigen::Map<const MatX> w(coefficients, n, c.rows);
    coefficients += static_cast<std::ptrdiff_t>(c.rows) * n;
    whole += w.col(0).squaredNorm();
    if (group.block < 0) continue;
    if (used[side] < 0) rows[side].setZero(group.S.cols(), c.rows);
    used[side] = group_of_[block];
    rows[side].noalias() += group.S.middleRows(first, n).transpose() * w;
  }
  for (int side = 0; side < 2; ++side)
    if (used[side] >= 0) left += rows[side].col(0).squaredNorm();
  if (left <= kIdle * kIdle * whole) {
    if (c.box > 0.0) idle_.push_back(i);
    return;
  }
  BlockContact reduced = c;
  reduced.a = groups_[used[0]].block;
  reduced.b = used[1] >= 0 ? groups_[used[1]].block : -1;
  reduced.row = static_cast<int>(reduced_.offset.size());
  reduced.column = static_cast<int>(reduced_.W.size());
  for (int side = 0; side < 2; ++side)
    if (used[side] >= 0) reduced_.W.insert(reduced_.W.end(), rows[side].data(), rows[side].data() + rows[side].size());
  reduced_.contacts.push_back(reduced);
  reduced_.offset.conservativeResize(reduced.row + c.rows);
  kept_.push_back(i);
}

void ConstrainedSolver::prepare(const BlockProblem& problem) {
  if (!any()) {
    solver_.prepare(problem);
    return;
  }
  reduced_.contacts.clear();
  reduced_.W.clear();
  reduced_.offset.resize(0);
  kept_.clear();
  idle_.clear();
  for (int i = 0; i < static_cast<int>(problem.contacts.size()); ++i) add_contact(problem, i);
  solver_.prepare(reduced_);
}

// The reduced problem about the velocity v, from the impulses lambda.
void ConstrainedSolver::begin(const BlockProblem& problem, const VecCRef& lambda, const VecCRef& v) {
  split(v);
  lambda_.resize(reduced_.rows());
  for (std::size_t k = 0; k < kept_.size(); ++k) {
    const BlockContact& c = problem.contacts[kept_[k]];
    BlockContact& reduced = reduced_.contacts[k];
    reduced.mu = c.mu;
    reduced.lower = c.lower;
    reduced.box = c.box;
    lambda_.segment(reduced.row, c.rows) = lambda.segment(c.row, c.rows);
    for (int r = 0; r < c.rows; ++r)
      reduced_.offset[reduced.row + r] = problem.offset[c.row + r] + row_velocity(problem, c, r, held_);
  }
}

void ConstrainedSolver::finish(const BlockProblem& problem, VecRef lambda, VecRef v) const {
  join(v);
  lambda.setZero();
  for (std::size_t k = 0; k < kept_.size(); ++k) {
    const BlockContact &c = problem.contacts[kept_[k]], &reduced = reduced_.contacts[k];
    lambda.segment(c.row, c.rows) = lambda_.segment(reduced.row, c.rows);
  }
  // Friction of a joint that equations move acts in full, and they bear it.
  const double still = kStill * (1.0 + v.cwiseAbs().maxCoeff());
  for (int i : idle_) {
    const BlockContact& c = problem.contacts[i];
    const double speed = row_velocity(problem, c, 0, v);
    if (std::abs(speed) > still) lambda[c.row] = -std::copysign(c.box, speed);
  }
}

BlockResult ConstrainedSolver::solve(const BlockProblem& problem, double bound, const BlockOptions& options,
                                     VecRef lambda, VecRef v) {
  if (!any()) return solver_.solve(problem, bound, options, lambda, v);
  begin(problem, lambda, problem.v_free);
  reduced_.v_free = u_;
  const BlockResult result = solver_.solve(reduced_, bound, options, lambda_, u_);
  finish(problem, lambda, v);
  return result;
}

BlockResult ConstrainedSolver::solve_normals(const BlockProblem& problem, double tolerance, VecRef lambda, VecRef v) {
  if (!any()) return solver_.solve_normals(problem, tolerance, lambda, v);
  begin(problem, lambda, problem.v_free);
  reduced_.v_free = u_;
  const BlockResult result = solver_.solve_normals(reduced_, tolerance, lambda_, u_);
  finish(problem, lambda, v);
  return result;
}

void ConstrainedSolver::free_velocity(const BlockProblem& problem, VecCRef lambda, VecCRef v, VecRef v_free) {
  if (!any()) {
    solver_.free_velocity(problem, lambda, v, v_free);
    return;
  }
  begin(problem, lambda, v);
  const VecX u = u_;
  solver_.free_velocity(reduced_, lambda_, u, u_);
  join(v_free);
}

}  // namespace contactvi

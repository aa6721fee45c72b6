#include "cone/reduced_solver.hpp"

#include <algorithm>
#include <cmath>

#include "base/disjoint_sets.hpp"
#include "base/tolerances.hpp"

namespace contactvi {

namespace {
constexpr double kRedundant = 1e-10;  // of the rows of equations, scaled: less is rounding
// Of the longest row of a group: shorter ones are not scaled to one. A planar loop on a body that hardly tilts has a
// row across its plane that is almost zero, and depends on the others but for rounding.
constexpr double kShort = 1e-2;
constexpr double kIdle = 1e-10;  // of a row of a contact: what equations leave of it is rounding
// A block of more degrees of freedom, on which less than this share of them in rows acts, is reduced: a smaller one
// costs less as it is.
constexpr Eigen::Index kSmallReduced = 24;
constexpr double kFewRows = 0.75;
}  // namespace

void ReducedSolver::set_equations(const BlockProblem& problem, const Eigen::Ref<const MatX>& W) {
  equations_ = static_cast<int>(W.cols());
  find_groups(problem, W);
  for (Group& group : groups_) find_basis(problem, W, group);
}

// Blocks on which the same equation acts belong together.
void ReducedSolver::find_groups(const BlockProblem& problem, const Eigen::Ref<const MatX>& W) {
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
    const int root = sets.root(b);
    if (group_of_[root] < 0) {
      group_of_[root] = static_cast<int>(groups_.size());
      groups_.emplace_back();
    }
    group_of_[b] = group_of_[root];
    Group& group = groups_[group_of_[b]];
    group.blocks.push_back(b);
    for (int d = problem.start[b]; d < problem.start[b + 1]; ++d) group.dofs.push_back(d);
  }
  for (int e = 0; e < equations_; ++e)
    if (touched[e] >= 0) groups_[group_of_[touched[e]]].equations.push_back(e);
}

MatX ReducedSolver::times_masses(const BlockProblem& problem, const Group& group, const MatX& X) const {
  MatX MX(X.rows(), X.cols());
  Eigen::Index first = 0;
  for (int b : group.blocks) {
    const Eigen::Index size = problem.size(b);
    MX.middleRows(first, size).noalias() = problem.M[b] * X.middleRows(first, size);
    first += size;
  }
  return MX;
}

void ReducedSolver::find_basis(const BlockProblem& problem, const Eigen::Ref<const MatX>& W, Group& group) {
  const auto n = static_cast<Eigen::Index>(group.dofs.size()), m = static_cast<Eigen::Index>(group.equations.size());
  if (m == 0) return;
  group.rows.resize(n, m);
  group.scale.resize(m);
  for (Eigen::Index e = 0; e < m; ++e) group.rows.col(e) = W.col(group.equations[e])(group.dofs);
  group.scale = group.rows.colwise().norm();
  group.scale = group.scale.cwiseMax(kShort * group.scale.maxCoeff()).cwiseInverse();
  group.rows *= group.scale.asDiagonal();
  group.decomposed.setThreshold(kRedundant);
  group.decomposed.compute(group.rows);
  group.N.setZero(n, n - group.decomposed.rank());
  group.N.bottomRows(group.N.cols()).setIdentity();
  group.N.applyOnTheLeft(group.decomposed.householderQ());
  group.MN = times_masses(problem, group, group.N);
  group.NMN = group.N.transpose() * group.MN;
  group.masses.compute(group.NMN);
}

void ReducedSolver::project(const VecCRef& rate, VecRef v) const {
  for (const Group& group : groups_) {
    if (group.equations.empty()) continue;
    // The least change that satisfies the equations, and what of it the free velocities take back.
    const VecX start = v(group.dofs);
    const VecX missing = VecX(rate(group.equations)).cwiseProduct(group.scale) - group.rows.transpose() * start;
    VecX change = group.decomposed.transpose().solve(missing);
    if (group.N.cols() > 0) change -= group.N * group.masses.solve(group.MN.transpose() * change);
    v(group.dofs) = start + change;
  }
}

VecX ReducedSolver::multipliers(const VecCRef& p) const {
  VecX mu = VecX::Zero(equations_);
  for (const Group& group : groups_)
    if (!group.equations.empty())
      mu(group.equations) = group.decomposed.solve(VecX(p(group.dofs))).cwiseProduct(group.scale);
  return mu;
}

// The rows of a contact in its groups. False: they move nothing that is free.
bool ReducedSolver::find_sides(const BlockProblem& problem, const BlockContact& c, Side (&sides)[2]) const {
  double whole = 0.0, left = 0.0;  // squares of the first row
  const double* coefficients = problem.W.data() + c.column;
  for (int block : {c.a, c.b}) {
    if (block < 0) continue;
    const Group& group = groups_[group_of_[block]];
    const int n = problem.size(block);
    const Eigen::Map<const MatX> w(coefficients, n, c.rows);
    coefficients += static_cast<std::ptrdiff_t>(c.rows) * n;
    whole += w.col(0).squaredNorm();
    if (!group.equations.empty() && group.N.cols() == 0) continue;
    Side& side = sides[0].group < 0 || sides[0].group == group_of_[block] ? sides[0] : sides[1];
    if (group.equations.empty()) {
      side.rows = w;
    } else {
      Eigen::Index first = 0;
      for (std::size_t k = 0; group.blocks[k] != block; ++k) first += problem.size(group.blocks[k]);
      if (side.group < 0) side.rows.setZero(group.N.cols(), c.rows);
      side.rows.noalias() += group.N.middleRows(first, n).transpose() * w;
    }
    side.group = group_of_[block];
  }
  for (const Side& side : sides)
    if (side.group >= 0) left += side.rows.col(0).squaredNorm();
  return left > kIdle * kIdle * whole;
}

VecX ReducedSolver::Group::coordinates(const VecX& v) const {
  VecX x = free() ? v : VecX(masses.solve(MN.transpose() * v));
  if (!few) return x;
  inverse.matrixL().solveInPlace(x);
  x.applyOnTheLeft(reached.householderQ().transpose());
  return x.head(touching);
}

VecX ReducedSolver::Group::velocity(const VecX& u) const {
  VecX x = u;
  if (few) {
    x = VecX::Zero(reached.rows());
    x.head(touching) = u;
    x.applyOnTheLeft(reached.householderQ());
    x = inverse.matrixL() * x;
  }
  return free() ? x : VecX(N * x);
}

// The basis S of a group, and its block of the reduced problem.
void ReducedSolver::choose(const BlockProblem& problem, Group& group, int number) {
  const auto size = group.free() ? static_cast<Eigen::Index>(group.dofs.size()) : group.N.cols();
  group.few = size > kSmallReduced && group.touching < kFewRows * static_cast<double>(size);
  group.block = size == 0 || (group.few && group.touching == 0) ? -1 : reduced_.blocks();
  group.first = reduced_.start.back();
  if (group.block < 0) return;
  reduced_.M.resize(group.block + 1);
  if (group.few) {
    if (group.free())
      group.inverse = problem.M.factor(group.blocks[0]);
    else
      group.inverse.compute(group.masses.solve(MatX::Identity(size, size)));
    MatX A(size, group.touching);
    Eigen::Index column = 0;
    for (std::array<Side, 2>& contact : sides_)
      for (Side& side : contact) {
        if (side.group != number) continue;
        A.middleCols(column, side.rows.cols()) = side.rows;
        side.column = static_cast<int>(column);
        column += side.rows.cols();
      }
    A = group.inverse.matrixU() * A;
    group.reached.compute(A);
    reduced_.M.set(group.block, MatX::Identity(group.touching, group.touching));
  } else if (group.free()) {
    reduced_.M.copy(group.block, problem.M, group.blocks[0]);
  } else {
    reduced_.M.set(group.block, group.NMN);
  }
  reduced_.start.push_back(group.first + static_cast<int>(reduced_.M.inverse(group.block).rows()));
}

void ReducedSolver::add_contact(const BlockContact& c, int number) {
  BlockContact reduced = c;
  std::array<Side, 2>& sides = sides_[number];
  reduced.a = groups_[sides[0].group].block;
  reduced.b = sides[1].group >= 0 ? groups_[sides[1].group].block : -1;
  reduced.row = static_cast<int>(reduced_.offset.size());
  reduced.column = static_cast<int>(reduced_.W.size());
  for (Side& side : sides) {
    if (side.group < 0) continue;
    const Group& group = groups_[side.group];
    if (group.few) {
      side.rows = group.reached.matrixQR().block(0, side.column, group.touching, side.rows.cols());
      for (Eigen::Index k = 0; k < side.rows.cols(); ++k)
        side.rows.col(k).tail(group.touching - side.column - k - 1).setZero();
    }
    reduced_.W.insert(reduced_.W.end(), side.rows.data(), side.rows.data() + side.rows.size());
  }
  reduced_.contacts.push_back(reduced);
  reduced_.offset.conservativeResize(reduced.row + c.rows);
}

// Without contacts whose normal moves nothing that is free, and joint friction of that kind.
void ReducedSolver::prepare(const BlockProblem& problem) {
  reduces_ = any();
  for (Group& group : groups_) group.touching = 0;
  for (const BlockContact& c : problem.contacts)
    for (int block : {c.a, c.b})
      if (block >= 0) groups_[group_of_[block]].touching += c.rows;
  for (const Group& group : groups_) {
    const auto size = static_cast<Eigen::Index>(group.dofs.size());
    reduces_ |= size > kSmallReduced && group.touching < kFewRows * static_cast<double>(size);
  }
  if (!reduces_) {
    solver_.prepare(problem);
    return;
  }
  reduced_.contacts.clear();
  reduced_.W.clear();
  reduced_.M.resize(0);
  reduced_.offset.resize(0);
  reduced_.start = {0};
  for (std::vector<int>* list : {&kept_, &idle_}) list->clear();
  sides_.clear();
  for (Group& group : groups_) group.touching = 0;
  std::vector<int> place(problem.contacts.size(), -1);  // among those that are kept
  for (int i = 0; i < static_cast<int>(problem.contacts.size()); ++i) {
    const BlockContact& c = problem.contacts[i];
    Side sides[2];
    // Turning friction stays with its point, which stands before it.
    if (!find_sides(problem, c, sides) && !(c.of >= 0 && place[c.of] >= 0)) {
      if (c.box > 0.0) idle_.push_back(i);
      continue;
    }
    if (c.of >= 0 && place[c.of] < 0) continue;
    place[i] = static_cast<int>(kept_.size());
    kept_.push_back(i);
    for (const Side& side : sides)
      if (side.group >= 0) groups_[side.group].touching += c.rows;
    sides_.push_back({std::move(sides[0]), std::move(sides[1])});
  }
  for (int g = 0; g < static_cast<int>(groups_.size()); ++g) choose(problem, groups_[g], g);
  for (int k = 0; k < static_cast<int>(kept_.size()); ++k) {
    BlockContact c = problem.contacts[kept_[k]];
    if (c.of >= 0) c.of = place[c.of];
    if (c.turning >= 0) c.turning = place[c.turning];
    add_contact(c, k);
  }
  solver_.prepare(reduced_);
}

// held_ and u_ of v.
void ReducedSolver::split(const VecCRef& v) {
  held_ = v;
  u_.resize(reduced_.start.back());
  for (const Group& group : groups_) {
    if (group.block < 0) continue;
    const VecX part = group.coordinates(v(group.dofs));
    u_.segment(group.first, part.size()) = part;
    if (group.whole())
      held_(group.dofs).setZero();
    else
      held_(group.dofs) -= group.velocity(part);
  }
}

void ReducedSolver::join(VecRef v) const {
  v = held_;
  for (const Group& group : groups_) {
    if (group.block < 0) continue;
    v(group.dofs) += group.velocity(u_.segment(group.first, reduced_.size(group.block)));
  }
}

double ReducedSolver::held_energy(const BlockProblem& problem) const {
  double energy = 0.0;
  for (int b = 0; b < problem.blocks(); ++b) {
    const auto v = held_.segment(problem.start[b], problem.size(b));
    if (v.isZero(0.0)) continue;
    energy += 0.5 * problem.M.product(b, v, v);
  }
  return energy;
}

// The reduced problem about the velocity v, from the impulses lambda.
void ReducedSolver::begin(const BlockProblem& problem, const VecCRef& lambda, const VecCRef& v) {
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

void ReducedSolver::finish(const BlockProblem& problem, VecRef lambda, VecRef v) const {
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

BlockResult ReducedSolver::solve(const BlockProblem& problem, double bound, const BlockOptions& options, VecRef lambda,
                                 VecRef v) {
  if (!reduces_) return solver_.solve(problem, bound, options, lambda, v);
  begin(problem, lambda, problem.v_free);
  reduced_.v_free = u_;
  const BlockResult result =
      solver_.solve(reduced_, std::isfinite(bound) ? bound - held_energy(problem) : bound, options, lambda_, u_);
  finish(problem, lambda, v);
  return result;
}

BlockResult ReducedSolver::solve_normals(const BlockProblem& problem, double tolerance, VecRef lambda, VecRef v) {
  if (!reduces_) return solver_.solve_normals(problem, tolerance, lambda, v);
  begin(problem, lambda, problem.v_free);
  reduced_.v_free = u_;
  const BlockResult result = solver_.solve_normals(reduced_, tolerance, lambda_, u_);
  finish(problem, lambda, v);
  return result;
}

void ReducedSolver::free_velocity(const BlockProblem& problem, VecCRef lambda, VecCRef v, VecRef v_free) {
  if (!reduces_) {
    solver_.free_velocity(problem, lambda, v, v_free);
    return;
  }
  begin(problem, lambda, v);
  const VecX u = u_;
  solver_.free_velocity(reduced_, lambda_, u, u_);
  join(v_free);
}

}  // namespace contactvi

#include "step/step_map.hpp"

#include <algorithm>
#include <cmath>

#include "model/coordinates.hpp"

namespace contactvi {

namespace {
// Backward errors of a solution that is refined once, and of one that is no solution. That of elimination without
// exchanges between blocks is some 1e-15 where the matrix is mostly the mass matrix.
constexpr double kRefine = 1e-14, kAccept = 1e-12;
constexpr int kSamples = 8;  // sums of columns of which it is measured: a panel of the least width

int largest_component(const DofPattern& pattern) {
  std::size_t largest = 0;
  for (const std::vector<int>& dofs : pattern.components()) largest = std::max(largest, dofs.size());
  return static_cast<int>(largest);
}

}  // namespace

StepMap::StepMap(const Tree& tree, int stages, bool in_velocities)
    : NewtonMatrix(tree, stages, in_velocities),
      in_velocities_(in_velocities),
      mass_(pattern_, 1),
      is_split_(tree.nv, false),
      xi_(tree.nv, stages),
      xi1_(tree.nv),
      right_(0),
      solution_(0),
      residual_(0),
      sample_(0),
      total_(0),
      turn_(0),
      matrix_(2 * tree.nv, columns_of(tree.nv)) {
  const std::size_t dofs = largest_component(pattern_),
                    numbers = dofs * padded_width(columns_of(static_cast<int>(dofs)));
  right_ = solution_ = residual_ = AlignedArray(numbers * stages);
  sample_ = AlignedArray(dofs * stages * kSamples);
  total_ = turn_ = AlignedArray(numbers);
  matrix_.setZero();
  for (const SplitJoint& joint : tree.split)
    for (int d = 0; d < (joint.planar ? 2 : 3); ++d) is_split_[joint.iv + d] = true;
}

// What a follower's own numbers at the start change by counts for nothing: they move with their leaders.
void StepMap::fold_columns() {
  const int n = tree_->nv;
  for (const Follower& f : tree_->followers)
    for (int kind = 0; kind < (in_velocities_ ? 2 : 1); ++kind) {
      for (const Follower::Leader& leader : f.leaders)
        matrix_.col(kind * n + leader.iv) += leader.ratio * matrix_.col(kind * n + f.iv);
      matrix_.col(kind * n + f.iv).setZero();
    }
}

// The mass matrix at the end; without velocities that of a stage, as it tells soon what elimination would lose.
bool StepMap::factor_mass() {
  const int point = in_velocities_ ? stages_.end() : 0;
  for (int c = 0; c < components(); ++c)
    each_pair(c, [&](int, int, DofPattern::Pair pair) { *mass_.at(pair) = stages_.M.at(pair)[point]; });
  fold_blocks(mass_);
  return mass_.factor() && mass_.cancellation() <= kMostCancellation;
}

// The backward error of some sums of columns: they all come from one factor, which loses digits or does not.
double StepMap::sampled_error(int component) {
  const int rows = static_cast<int>(pattern_.components()[component].size()) * blocks_.size(), group = count_ / 3;
  const auto sample = [&](const AlignedArray& panel, AlignedArray& found) {
    for (int r = 0; r < rows; ++r) {
      const double* row = panel.data() + static_cast<std::size_t>(r) * width_;
      double* out = found.data() + static_cast<std::size_t>(r) * kSamples;
      for (int kind = 0; kind < 3; ++kind) {
        double even = 0.0, odd = 0.0;
        for (int c = 0; c < group; ++c) (c % 2 == 0 ? even : odd) += row[kind * group + c];
        out[2 * kind] = even;
        out[2 * kind + 1] = odd;
      }
      out[6] = row[count_ - 1];
      out[7] = 0.0;
    }
  };
  sample(solution_, sample_);
  sample(right_, residual_);
  return blocks_.backward_error(component, sample_.data(), residual_.data(), kSamples);
}

bool StepMap::solve(int component) {
  const std::size_t numbers = pattern_.components()[component].size() * blocks_.size() * width_;
  std::copy_n(right_.data(), numbers, solution_.data());
  blocks_.solve(component, solution_.data(), width_);
  if (sampled_error(component) <= kRefine) return true;
  std::copy_n(right_.data(), numbers, residual_.data());
  blocks_.backward_error(component, solution_.data(), residual_.data(), width_);
  blocks_.solve(component, residual_.data(), width_);
  for (std::size_t i = 0; i < numbers; ++i) solution_[i] += residual_[i];
  return sampled_error(component) <= kAccept;
}

// Fills turn_ with dq1 and total_ with dp1.
void StepMap::make_ends(int component) {
  sum_ends(component, solution_.data(), width_, turn_.data(), total_.data());
  for (const int d : pattern_.components()[component]) {
    double* const turn = turn_row(d);
    turn[count_ - 1] += xi1_[d];
    if (ball_of_[d] < 0) turn[pattern_.place(d)] += 1.0;
  }
  turn_ends(component, width_, turn_.data(), total_.data());
  for (const Ball& ball : balls_) {
    if (!is_in(component, ball.iv)) continue;
    for (int r = 0; r < 3; ++r)
      for (int unit = 0; unit < 3; ++unit) turn_row(ball.iv + r)[pattern_.place(ball.iv) + unit] += ball.R1(unit, r);
  }
}

// v1 = M^-1 p1: dv1 = M^-1 (dp1 - B dq1).
void StepMap::to_velocities(int component) {
  each_pair(component, [&](int row, int column, DofPattern::Pair pair) {
    const double* B = stages_.B.at(pair) + stages_.end();
    kernel_->subtract_product(1, 1, width_, B, 1, turn_row(column), total_row(row), false);
  });
  fold_rows(total_.data(), 1, width_);
  mass_.solve(component, total_.data(), width_);
  follow_rows(total_.data(), 1, width_);
}

void StepMap::store(int component) {
  const std::vector<int>& dofs = pattern_.components()[component];
  const int n = tree_->nv, size = static_cast<int>(dofs.size());
  for (const int row : dofs) {
    const double *q = turn_row(row), *x = total_row(row);
    for (int kind = 0; kind < 3; ++kind)
      for (int c = 0; c < size; ++c) {
        matrix_(row, kind * n + dofs[c]) = q[kind * size + c];
        matrix_(n + row, kind * n + dofs[c]) = x[kind * size + c];
      }
    matrix_(row, 3 * n) = q[count_ - 1];
    matrix_(n + row, 3 * n) = x[count_ - 1];
  }
}

// The changes of the displacements with h.
void StepMap::set_lengthening() {
  const GaussTable& table = stages_.table();
  const int s = blocks_.size();
  for (int d = 0; d < tree_->nv; ++d) {
    xi1_[d] = 0.0;
    for (int j = 0; j < s; ++j) xi1_[d] += table.b[j] * stages_.u(d, j);
    for (int i = 0; i < s; ++i) {
      xi_(d, i) = 0.0;
      for (int j = 0; j < s; ++j) xi_(d, i) += table.A[i][j] * stages_.u(d, j);
    }
  }
}

bool StepMap::take(const StepSolution& step) {
  take_stages(step);
  set_lengthening();
  if (!factor_mass() || !factor()) return false;
  for (int c = 0; c < components(); ++c) {
    make_right_sides(c, step);
    fold_rows(right_.data(), blocks_.size(), width_);
    if (!solve(c)) return false;
    follow_rows(solution_.data(), blocks_.size(), width_);
    make_ends(c);
    if (!in_velocities_) fold_rows(total_.data(), 1, width_);
    if (in_velocities_) to_velocities(c);
    store(c);
  }
  fold_columns();
  return matrix_.allFinite();
}

void StepMap::apply(const MatX& q, const MatX& x, const MatX& tau, const VecX& h, MatX& q1, MatX& x1) const {
  const int n = tree_->nv;
  q1.resize(n, q.cols());
  x1.resize(n, q.cols());
  for (Eigen::Index k = 0; k < q.cols(); ++k) {
    double *dq = q1.col(k).data(), *dx = x1.col(k).data();
    for (int r = 0; r < n; ++r) {
      dq[r] = matrix_(r, 3 * n) * h[k];
      dx[r] = matrix_(n + r, 3 * n) * h[k];
    }
    for (const std::vector<int>& dofs : pattern_.components())
      for (const int c : dofs) {
        const double factor[3] = {q(c, k), x(c, k), tau.size() > 0 ? tau(c, k) : 0.0};
        for (int kind = 0; kind < 3; ++kind) {
          if (factor[kind] == 0.0) continue;
          const double* column = matrix_.col(kind * n + c).data();
          for (const int r : dofs) {
            dq[r] += factor[kind] * column[r];
            dx[r] += factor[kind] * column[n + r];
          }
        }
      }
  }
}

}  // namespace contactvi

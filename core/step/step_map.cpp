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
    : tree_(&tree),
      in_velocities_(in_velocities),
      kernel_(&lane_kernel(kMaxStages)),
      model_(tree),
      pattern_(tree),
      stages_(tree, model_, pattern_, stages, in_velocities),
      blocks_(pattern_, stages),
      mass_(pattern_, 1),
      output_(pattern_, stages),
      ball_of_(tree.nv, -1),
      is_split_(tree.nv, false),
      hA_(static_cast<std::size_t>(stages) * blocks_.stride()),
      balance_weight_(hA_),
      product_(hA_),
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
  for (const Joint& joint : tree.joints) {
    if (joint.type != JointType::kSpherical) continue;
    for (int d = 0; d < 3; ++d) ball_of_[joint.iv + d] = static_cast<int>(balls_.size());
    balls_.push_back({joint.iv, stages_.related(balls_.size()), {}, {}, {}, {}});
  }
  for (const SplitJoint& joint : tree.split)
    for (int d = 0; d < (joint.planar ? 2 : 3); ++d) is_split_[joint.iv + d] = true;
}

bool StepMap::is_in(int component, int dof) const {
  const std::vector<int>& dofs = pattern_.components()[component];
  const std::size_t place = pattern_.place(dof);
  return place < dofs.size() && dofs[place] == dof;
}

void StepMap::set_weights(double h) {
  const GaussTable& table = stages_.table();
  const int s = blocks_.size(), stride = blocks_.stride();
  for (int j = 0; j < s; ++j) {
    hb_[j] = h * table.b[j];
    minus_hb_[j] = -hb_[j];
  }
  for (int i = 0; i < s; ++i)
    for (int j = 0; j < s; ++j) {
      hA_[i * stride + j] = h * table.A[i][j];
      balance_weight_[i * stride + j] = h * table.A[i][j] - hb_[j];
    }
  for (int d = 0; d < tree_->nv; ++d) {
    xi1_[d] = 0.0;
    for (int j = 0; j < s; ++j) xi1_[d] += table.b[j] * stages_.u(d, j);
    for (int i = 0; i < s; ++i) {
      xi_(d, i) = 0.0;
      for (int j = 0; j < s; ++j) xi_(d, i) += table.A[i][j] * stages_.u(d, j);
    }
  }
}

void StepMap::set_balls(const StepSolution& step) {
  for (Ball& ball : balls_) {
    const Vec3 X1 = stages_.X1.segment<3>(ball.iv);
    Vec3 total = step.p0.segment<3>(ball.iv);
    for (int j = 0; j < blocks_.size(); ++j) total += hb_[j] * stages_.Y.col(j).segment<3>(ball.iv);
    ball.J1 = so3_right_jacobian(X1);
    ball.Z1 = so3_right_jacobian_change(X1, total);
    ball.R1 = so3_exp(X1).toRotationMatrix();
    ball.p1 = ball.R1.transpose() * total;
  }
}

// Row i, column j: delta M_i + h a_ij B_i - w_ij C_j - sum_k w_ik K_k h a_kj.
void StepMap::set_block(int row, DofPattern::Pair pair) {
  const int s = blocks_.size(), stride = blocks_.stride();
  double* const block = blocks_.at(pair);
  const double *M = stages_.M.at(pair), *B = stages_.B.at(pair), *C = stages_.C.at(pair), *K = stages_.K.at(pair);
  const double* weight = ball_of_[row] < 0 ? hA_.data() : balance_weight_.data();
  for (int i = 0; i < s; ++i) {
    for (int j = 0; j < s; ++j) {
      const int at = i * stride + j;
      block[at] = hA_[at] * B[i] - weight[at] * C[j];
      product_[at] = weight[at] * K[j];
    }
    block[i * stride + i] += M[i];
  }
  if (s == 1) {
    block[0] -= product_[0] * hA_[0];
  } else {
    kernel_->subtract_product(s, s, stride, product_.data(), stride, hA_.data(), block, false);
  }
}

void StepMap::set_output(int row, DofPattern::Pair pair) {
  const int s = blocks_.size(), stride = blocks_.stride();
  const bool ball = ball_of_[row] >= 0;
  const double *C = (ball ? stages_.C_Y : stages_.C).at(pair), *K = (ball ? stages_.K_Y : stages_.K).at(pair);
  double* const out = output_.at(pair);
  for (int j = 0; j < s; ++j) out[j] = -hb_[j] * C[j];
  for (int k = 0; k < s; ++k)
    for (int j = 0; j < s; ++j) out[j] -= hb_[k] * K[k] * hA_[k * stride + j];
}

// The share of d(J_r(X_1) (p_0 + sum h b_j Y_j)) in the rows of a spherical joint.
void StepMap::add_balance(const Ball& ball) {
  const int s = blocks_.size(), stride = blocks_.stride();
  for (const int column : ball.related)
    for (int r = 0; r < 3; ++r) {
      double* const block = blocks_.at(pattern_.pair(ball.iv + r, column));
      const int own = column - ball.iv;
      for (int j = 0; j < s; ++j) {
        double sum = own >= 0 && own < 3 ? ball.Z1(r, own) * hb_[j] : 0.0;
        for (int k = 0; k < 3; ++k) sum -= ball.J1(r, k) * output_.at(pattern_.pair(ball.iv + k, column))[j];
        for (int i = 0; i < s; ++i) block[i * stride + j] -= sum;
      }
    }
}

void StepMap::assemble() {
  for (int c = 0; c < components(); ++c)
    each_pair(c, [&](int row, int, DofPattern::Pair pair) {
      set_block(row, pair);
      set_output(row, pair);
    });
  for (const Ball& ball : balls_) add_balance(ball);
  fold_blocks(blocks_);
}

// The blocks of the pattern, which is one chain, become those of the leaders.
void StepMap::fold_blocks(TreeBlocks& blocks) {
  const int n = tree_->nv, area = blocks.size() * blocks.stride();
  const auto block = [&](int row, int column) { return blocks.at(pattern_.pair(row, column)); };
  for (const Follower& f : tree_->followers) {
    for (const Follower::Leader& leader : f.leaders) {
      for (int c = 0; c < n; ++c)
        for (int k = 0; k < area; ++k) block(leader.iv, c)[k] += leader.ratio * block(f.iv, c)[k];
      for (int r = 0; r < n; ++r)
        for (int k = 0; k < area; ++k) block(r, leader.iv)[k] += leader.ratio * block(r, f.iv)[k];
    }
    for (int d = 0; d < n; ++d) {
      std::fill_n(block(f.iv, d), area, 0.0);
      std::fill_n(block(d, f.iv), area, 0.0);
    }
    for (int i = 0; i < blocks.size(); ++i) block(f.iv, f.iv)[i * blocks.stride() + i] = 1.0;
  }
}

// S^T of the right sides in a panel of so many rows per dof.
void StepMap::fold_rows(double* panel, int rows_per_dof) const {
  const auto row = [&](int dof) {
    return panel + static_cast<std::size_t>(pattern_.place(dof)) * rows_per_dof * width_;
  };
  for (const Follower& f : tree_->followers) {
    for (const Follower::Leader& leader : f.leaders)
      for (int i = 0; i < rows_per_dof * width_; ++i) row(leader.iv)[i] += leader.ratio * row(f.iv)[i];
    std::fill_n(row(f.iv), rows_per_dof * width_, 0.0);
  }
}

// The rows of followers from those of their leaders.
void StepMap::follow_rows(double* panel, int rows_per_dof) const {
  const auto row = [&](int dof) {
    return panel + static_cast<std::size_t>(pattern_.place(dof)) * rows_per_dof * width_;
  };
  for (const Follower& f : tree_->followers) {
    std::fill_n(row(f.iv), rows_per_dof * width_, 0.0);
    for (const Follower::Leader& leader : f.leaders)
      for (int i = 0; i < rows_per_dof * width_; ++i) row(f.iv)[i] += leader.ratio * row(leader.iv)[i];
  }
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
  const std::vector<int>& dofs = pattern_.components()[component];
  const int s = blocks_.size();
  each_pair(component, [&](int row, int column, DofPattern::Pair pair) {
    kernel_->subtract_product(1, s, width_, output_.at(pair), s, solution_row(column, 0), total_row(row), false);
  });
  for (const int d : dofs) {
    double* const turn = turn_row(d);
    kernel_->subtract_product(1, s, width_, minus_hb_, s, solution_row(d, 0), turn, true);
    turn[count_ - 1] += xi1_[d];
    if (ball_of_[d] < 0) turn[pattern_.place(d)] += 1.0;
  }
  for (const Ball& ball : balls_) {
    if (!is_in(component, ball.iv)) continue;
    double *dq[3], *dp[3];
    for (int r = 0; r < 3; ++r) {
      dq[r] = turn_row(ball.iv + r);
      dp[r] = total_row(ball.iv + r);
    }
    for (int c = 0; c < width_; ++c) {
      const Vec3 own = ball.J1 * Vec3(dq[0][c], dq[1][c], dq[2][c]);
      const int unit = c - pattern_.place(ball.iv);
      const Vec3 start = unit >= 0 && unit < 3 ? Vec3(ball.R1.row(unit)) : Vec3(Vec3::Zero());
      const Vec3 moved = start + own;
      const Vec3 p = ball.R1.transpose() * Vec3(dp[0][c], dp[1][c], dp[2][c]) - own.cross(ball.p1);
      for (int r = 0; r < 3; ++r) {
        dq[r][c] = moved[r];
        dp[r][c] = p[r];
      }
    }
  }
}

// v1 = M^-1 p1: dv1 = M^-1 (dp1 - B dq1).
void StepMap::to_velocities(int component) {
  each_pair(component, [&](int row, int column, DofPattern::Pair pair) {
    const double* B = stages_.B.at(pair) + stages_.end();
    kernel_->subtract_product(1, 1, width_, B, 1, turn_row(column), total_row(row), false);
  });
  fold_rows(total_.data(), 1);
  mass_.solve(component, total_.data(), width_);
  follow_rows(total_.data(), 1);
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

bool StepMap::take(const StepSolution& step) {
  stages_.take(step);
  set_weights(step.h);
  set_balls(step);
  if (!factor_mass()) return false;
  assemble();
  if (!blocks_.factor() || blocks_.cancellation() > kMostCancellation) return false;
  for (int c = 0; c < components(); ++c) {
    make_right_sides(c, step);
    fold_rows(right_.data(), blocks_.size());
    if (!solve(c)) return false;
    follow_rows(solution_.data(), blocks_.size());
    make_ends(c);
    if (!in_velocities_) fold_rows(total_.data(), 1);
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

#include "step/newton_matrix.hpp"

#include <algorithm>

namespace contactvi {

NewtonMatrix::NewtonMatrix(const Tree& tree, int stages, bool with_nodes)
    : tree_(&tree),
      kernel_(&lane_kernel(kMaxStages)),
      model_(tree),
      pattern_(tree),
      stages_(tree, model_, pattern_, stages, with_nodes),
      blocks_(pattern_, stages),
      output_(pattern_, stages),
      ball_of_(tree.nv, -1),
      hA_(static_cast<std::size_t>(stages) * blocks_.stride()),
      balance_weight_(hA_),
      product_(hA_) {
  for (const Joint& joint : tree.joints) {
    if (joint.type != JointType::kSpherical) continue;
    for (int d = 0; d < 3; ++d) ball_of_[joint.iv + d] = static_cast<int>(balls_.size());
    balls_.push_back({joint.iv, stages_.related(balls_.size()), {}, {}, {}, {}});
  }
}

bool NewtonMatrix::is_in(int component, int dof) const {
  const std::vector<int>& dofs = pattern_.components()[component];
  const std::size_t place = pattern_.place(dof);
  return place < dofs.size() && dofs[place] == dof;
}

void NewtonMatrix::set_weights(double h) {
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
}

void NewtonMatrix::set_balls(const StepSolution& step) {
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
void NewtonMatrix::set_block(int row, DofPattern::Pair pair) {
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

void NewtonMatrix::set_output(int row, DofPattern::Pair pair) {
  const int s = blocks_.size(), stride = blocks_.stride();
  const bool ball = ball_of_[row] >= 0;
  const double *C = (ball ? stages_.C_Y : stages_.C).at(pair), *K = (ball ? stages_.K_Y : stages_.K).at(pair);
  double* const out = output_.at(pair);
  for (int j = 0; j < s; ++j) out[j] = -hb_[j] * C[j];
  for (int k = 0; k < s; ++k)
    for (int j = 0; j < s; ++j) out[j] -= hb_[k] * K[k] * hA_[k * stride + j];
}

// The share of d(J_r(X_1) (p_0 + sum h b_j Y_j)) in the rows of a spherical joint.
void NewtonMatrix::add_balance(const Ball& ball) {
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

void NewtonMatrix::take_stages(const StepSolution& step) {
  stages_.take(step);
  set_weights(step.h);
  set_balls(step);
}

bool NewtonMatrix::factor() {
  for (int c = 0; c < components(); ++c)
    each_pair(c, [&](int row, int, DofPattern::Pair pair) {
      set_block(row, pair);
      set_output(row, pair);
    });
  for (const Ball& ball : balls_) add_balance(ball);
  fold_blocks(blocks_);
  return blocks_.factor() && blocks_.cancellation() <= kMostCancellation;
}

// The blocks of the pattern, which is one chain, become those of the leaders.
void NewtonMatrix::fold_blocks(TreeBlocks& blocks) {
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

void NewtonMatrix::fold_rows(double* panel, int rows_per_dof, int width) const {
  const auto row = [&](int dof) {
    return panel + static_cast<std::size_t>(pattern_.place(dof)) * rows_per_dof * width;
  };
  for (const Follower& f : tree_->followers) {
    for (const Follower::Leader& leader : f.leaders)
      for (int i = 0; i < rows_per_dof * width; ++i) row(leader.iv)[i] += leader.ratio * row(f.iv)[i];
    std::fill_n(row(f.iv), rows_per_dof * width, 0.0);
  }
}

void NewtonMatrix::follow_rows(double* panel, int rows_per_dof, int width) const {
  const auto row = [&](int dof) {
    return panel + static_cast<std::size_t>(pattern_.place(dof)) * rows_per_dof * width;
  };
  for (const Follower& f : tree_->followers) {
    std::fill_n(row(f.iv), rows_per_dof * width, 0.0);
    for (const Follower::Leader& leader : f.leaders)
      for (int i = 0; i < rows_per_dof * width; ++i) row(f.iv)[i] += leader.ratio * row(leader.iv)[i];
  }
}

void NewtonMatrix::sum_ends(int component, const double* solution, int width, double* moved, double* total) const {
  const int s = blocks_.size();
  const auto from = [&](int dof) { return solution + static_cast<std::size_t>(pattern_.place(dof)) * s * width; };
  const auto to = [&](double* rows, int dof) { return rows + static_cast<std::size_t>(pattern_.place(dof)) * width; };
  each_pair(component, [&](int row, int column, DofPattern::Pair pair) {
    kernel_->subtract_product(1, s, width, output_.at(pair), s, from(column), to(total, row), false);
  });
  for (const int d : pattern_.components()[component])
    kernel_->subtract_product(1, s, width, minus_hb_, s, from(d), to(moved, d), true);
}

void NewtonMatrix::turn_ends(int component, int width, double* moved, double* total) const {
  for (const Ball& ball : balls_) {
    if (!is_in(component, ball.iv)) continue;
    double *dq[3], *dp[3];
    for (int r = 0; r < 3; ++r) {
      const std::size_t at = static_cast<std::size_t>(pattern_.place(ball.iv + r)) * width;
      dq[r] = moved + at;
      dp[r] = total + at;
    }
    for (int c = 0; c < width; ++c) {
      const Vec3 turn = ball.J1 * Vec3(dq[0][c], dq[1][c], dq[2][c]);
      const Vec3 p = ball.R1.transpose() * Vec3(dp[0][c], dp[1][c], dp[2][c]) - turn.cross(ball.p1);
      for (int r = 0; r < 3; ++r) {
        dq[r][c] = turn[r];
        dp[r][c] = p[r];
      }
    }
  }
}

}  // namespace contactvi

#include "step/step_map.hpp"

#include <algorithm>
#include <cmath>

#include "model/coordinates.hpp"

namespace contactvi {

namespace {
// Backward errors of a solution that is refined once, and of one that is no solution. That of elimination without
// exchanges between blocks is some 1e-15 where the matrix is mostly the mass matrix.
constexpr double kRefine = 1e-14, kAccept = 1e-12;

int largest_component(const DofPattern& pattern) {
  std::size_t largest = 0;
  for (const std::vector<int>& dofs : pattern.components()) largest = std::max(largest, dofs.size());
  return static_cast<int>(largest);
}

int columns_of(int dofs) { return 3 * dofs + 1; }

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
      total_(0),
      turn_(0),
      matrix_(2 * tree.nv, columns_of(tree.nv)) {
  const std::size_t dofs = largest_component(pattern_), numbers = dofs * padded_width(columns_of(static_cast<int>(dofs)));
  right_ = solution_ = residual_ = AlignedArray(numbers * stages);
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
  for (int j = 0; j < s; ++j) hb_[j] = h * table.b[j];
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
    kernel_->subtract_product(s, stride, product_.data(), stride, hA_.data(), block, false);
  }
}

void StepMap::set_output(int row, DofPattern::Pair pair) {
  const int s = blocks_.size(), stride = blocks_.stride();
  const bool ball = ball_of_[row] >= 0;
  const double *C = (ball ? stages_.C_Y : stages_.C).at(pair), *K = (ball ? stages_.K_Y : stages_.K).at(pair);
  double* const out = output_.at(pair);
  for (int j = 0; j < s; ++j) out[j] = hb_[j] * C[j];
  for (int k = 0; k < s; ++k)
    for (int j = 0; j < s; ++j) out[j] += hb_[k] * K[k] * hA_[k * stride + j];
}

// Calls visit(row, column, pair) for each pair of dofs of a component.
template <class Visit>
void StepMap::each_pair(int component, Visit visit) const {
  for (const int d : pattern_.components()[component]) {
    for (int g = 0; g < pattern_.level(d); ++g) {
      const int a = pattern_.on_path(d, g), entry = pattern_.entry(d, g);
      visit(d, a, DofPattern::Pair{true, entry});
      visit(a, d, DofPattern::Pair{false, entry});
    }
    visit(d, d, DofPattern::Pair{true, pattern_.diagonal(d)});
  }
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
        for (int k = 0; k < 3; ++k) sum += ball.J1(r, k) * output_.at(pattern_.pair(ball.iv + k, column))[j];
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
}

// The mass matrix at the end; without velocities that of a stage, as it tells soon what elimination would lose.
bool StepMap::factor_mass() {
  const int point = in_velocities_ ? stages_.end() : 0;
  for (int c = 0; c < components(); ++c)
    each_pair(c, [&](int, int, DofPattern::Pair pair) { *mass_.at(pair) = stages_.M.at(pair)[point]; });
  return mass_.factor() && mass_.cancellation() <= kMostCancellation;
}

// Adds a change of the start momentum.
void StepMap::add_start(int row, int column, double change) {
  total_row(row)[column] += change;
  if (ball_of_[row] >= 0) return;  // close_right_sides()
  for (int i = 0; i < blocks_.size(); ++i) right_row(row, i)[column] += change;
}

// Adds changes of the momenta and the forces at the stages; of_total: those of the forces in the sum at the end.
void StepMap::add_stages(int row, int column, const double* momentum, const double* force, const double* of_total) {
  const int s = blocks_.size(), stride = blocks_.stride();
  const double* weight = ball_of_[row] < 0 ? hA_.data() : balance_weight_.data();
  double sum = 0.0;
  for (int k = 0; k < s; ++k) sum += hb_[k] * of_total[k];
  total_row(row)[column] += sum;
  for (int i = 0; i < s; ++i) {
    double change = -momentum[i];
    for (int k = 0; k < s; ++k) change += weight[i * stride + k] * force[k];
    right_row(row, i)[column] += change;
  }
}

// The columns of q0, x0 and h of what one dof does to another.
void StepMap::add_pair(int row, int column, DofPattern::Pair pair) {
  const int s = blocks_.size(), place = pattern_.place(column);
  const bool ball = ball_of_[row] >= 0, balls = !balls_.empty();
  const double *B = stages_.B.at(pair), *K = stages_.K.at(pair);
  const double* K_total = ball ? stages_.K_Y.at(pair) : K;
  const double *B_q = balls ? stages_.B_q.at(pair) : B, *K_q = balls ? stages_.K_q.at(pair) : K;
  add_stages(row, place, B_q, K_q, ball ? stages_.K_Yq.at(pair) : K_q);
  double momentum[kMaxStages], force[kMaxStages], total[kMaxStages];
  for (int i = 0; i < s; ++i) {
    momentum[i] = B[i] * xi_(column, i);
    force[i] = K[i] * xi_(column, i);
    total[i] = K_total[i] * xi_(column, i);
  }
  add_stages(row, count_ - 1, momentum, force, total);
  if (!in_velocities_) return;
  add_start(row, place, stages_.B.at(pair)[stages_.start()]);
  add_start(row, count_ / 3 + place, stages_.M.at(pair)[stages_.start()]);
}

// The columns of tau, of dofs that are not split: a force of the joint's axes, which turn on spherical ones.
void StepMap::add_inputs(int dof) {
  const int s = blocks_.size(), column = 2 * (count_ / 3) + pattern_.place(dof);
  const double none[kMaxStages] = {}, one[kMaxStages] = {1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0};
  if (ball_of_[dof] < 0) {
    add_stages(dof, column, none, one, one);
    return;
  }
  const int iv = balls_[ball_of_[dof]].iv;
  for (int r = 0; r < 3; ++r) {
    double force[kMaxStages], total[kMaxStages];
    for (int i = 0; i < s; ++i) {
      const BallChart& chart = stages_.chart(ball_of_[dof], i);
      force[i] = chart.J(dof - iv, r);
      total[i] = chart.R(r, dof - iv);
    }
    add_stages(iv + r, column, none, force, total);
  }
}

// Those of split joints, R tau.
void StepMap::add_split_inputs(const SplitJoint& joint, const VecX& q0) {
  const int s = blocks_.size(), size = joint.planar ? 2 : 3;
  const double none[kMaxStages] = {};
  Mat3 axes[kMaxStages];
  for (int i = 0; i < s; ++i) axes[i] = split_axes(joint, q0, stages_.X.col(i));
  for (int c = 0; c < size; ++c)
    for (int r = 0; r < size; ++r) {
      double force[kMaxStages];
      for (int i = 0; i < s; ++i) force[i] = axes[i](r, c);
      add_stages(joint.iv + r, 2 * (count_ / 3) + pattern_.place(joint.iv + c), none, force, force);
    }
}

// The column of h has the forces themselves: h is a factor of their sums.
void StepMap::add_length(int row) {
  const GaussTable& table = stages_.table();
  const int s = blocks_.size();
  const bool ball = ball_of_[row] >= 0;
  for (int k = 0; k < s; ++k) {
    const double force = stages_.G_x(row, k);
    total_row(row)[count_ - 1] += table.b[k] * (ball ? stages_.Y(row, k) : force);
    for (int i = 0; i < s; ++i)
      right_row(row, i)[count_ - 1] += (table.A[i][k] - (ball ? table.b[k] : 0.0)) * force;
  }
}

void StepMap::make_right_sides(int component, const StepSolution& step) {
  const std::vector<int>& dofs = pattern_.components()[component];
  const std::size_t size = dofs.size();
  count_ = columns_of(static_cast<int>(size));
  width_ = padded_width(count_);
  std::fill_n(right_.data(), size * blocks_.size() * width_, 0.0);
  std::fill_n(total_.data(), size * width_, 0.0);
  each_pair(component, [&](int row, int column, DofPattern::Pair pair) { add_pair(row, column, pair); });
  for (const int d : dofs) {
    if (!in_velocities_) add_start(d, count_ / 3 + pattern_.place(d), 1.0);
    if (!is_split_[d]) add_inputs(d);
    add_length(d);
  }
  for (const SplitJoint& joint : tree_->split)
    if (is_in(component, joint.iv)) add_split_inputs(joint, step.q0);
  for (const Ball& ball : balls_) {
    if (!is_in(component, ball.iv)) continue;
    for (int c = 0; c < width_; ++c) {
      Vec3 start = ball.J1 * Vec3(total_row(ball.iv)[c], total_row(ball.iv + 1)[c], total_row(ball.iv + 2)[c]);
      if (c == count_ - 1) start += ball.Z1 * xi1_.segment<3>(ball.iv);
      for (int r = 0; r < 3; ++r)
        for (int i = 0; i < blocks_.size(); ++i) right_row(ball.iv + r, i)[c] += start[r];
    }
  }
}

bool StepMap::solve(int component) {
  const std::size_t numbers = pattern_.components()[component].size() * blocks_.size() * width_;
  std::copy_n(right_.data(), numbers, solution_.data());
  std::copy_n(right_.data(), numbers, residual_.data());
  blocks_.solve(component, solution_.data(), width_);
  double error = blocks_.backward_error(component, solution_.data(), residual_.data(), width_);
  if (error > kRefine) {
    blocks_.solve(component, residual_.data(), width_);
    for (std::size_t i = 0; i < numbers; ++i) solution_[i] += residual_[i];
    std::copy_n(right_.data(), numbers, residual_.data());
    error = blocks_.backward_error(component, solution_.data(), residual_.data(), width_);
  }
  return error <= kAccept;
}

// Fills turn_ with dq1 and total_ with dp1.
void StepMap::make_ends(int component) {
  const std::vector<int>& dofs = pattern_.components()[component];
  const int s = blocks_.size(), size = static_cast<int>(dofs.size());
  each_pair(component, [&](int row, int column, DofPattern::Pair pair) {
    const double* out = output_.at(pair);
    double* total = total_row(row);
    for (int j = 0; j < s; ++j) {
      const double* du = solution_row(column, j);
      for (int c = 0; c < width_; ++c) total[c] += out[j] * du[c];
    }
  });
  std::fill_n(turn_.data(), static_cast<std::size_t>(size) * width_, 0.0);
  for (const int d : dofs) {
    double* const turn = turn_row(d);
    for (int j = 0; j < s; ++j)
      for (int c = 0; c < width_; ++c) turn[c] += hb_[j] * solution_row(d, j)[c];
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
    const double B = stages_.B.at(pair)[stages_.end()];
    double* p = total_row(row);
    const double* q = turn_row(column);
    for (int c = 0; c < width_; ++c) p[c] -= B * q[c];
  });
  mass_.solve(component, total_.data(), width_);
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
    if (!solve(c)) return false;
    make_ends(c);
    if (in_velocities_) to_velocities(c);
    store(c);
  }
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

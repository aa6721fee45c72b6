// StepMap: the right sides, which is what the start, the input and the length of the step change directly.
#include <algorithm>

#include "model/coordinates.hpp"
#include "step/step_map.hpp"

namespace contactvi {

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
    for (int i = 0; i < s; ++i) right_row(row, i)[count_ - 1] += (table.A[i][k] - (ball ? table.b[k] : 0.0)) * force;
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

}  // namespace contactvi

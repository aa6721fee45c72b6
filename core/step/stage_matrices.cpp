#include "step/stage_matrices.hpp"

#include <algorithm>
#include <cmath>

#include "model/coordinates.hpp"

namespace contactvi {

StageMatrices::StageMatrices(const Tree& tree, const FlatModel& model, const DofPattern& pattern, int stages,
                             bool with_nodes)
    : M(local_.M),
      B(local_.B),
      C(local_.C),
      K(local_.K),
      B_q(pattern, model.lanes.balls > 0 ? stages + 2 * with_nodes : 0),
      K_q(B_q),
      C_Y(B_q),
      K_Y(B_q),
      K_Yq(B_q),
      X(tree.nv, stages),
      u(tree.nv, stages),
      G_x(tree.nv, stages),
      Y(MatX::Zero(tree.nv, stages)),
      X1(tree.nv),
      tree_(&tree),
      pattern_(&pattern),
      stages_(stages),
      with_nodes_(with_nodes),
      values_(tree, model, stages),
      local_(tree, model, pattern, stages + 2 * with_nodes),
      field_(tree),
      X_points_(MatX::Zero(tree.nv, stages + 2 * with_nodes)),
      v_points_(tree.nv, stages + 2 * with_nodes),
      q_(tree.nq),
      v_(tree.nv),
      dq_(tree.nv),
      dv_(tree.nv),
      df_(tree.nv) {
  for (std::size_t k = 0; k < tree.joints.size(); ++k) {
    const Joint& joint = tree.joints[k];
    if (joint.type != JointType::kSpherical) continue;
    balls_.push_back(static_cast<int>(k));
    related_.emplace_back();
    for (int d = 0; d < tree.nv; ++d) {
      const int own = joint.iv, low = std::min(d, own), high = std::max(d, own), level = pattern.level(low);
      if (pattern.level(high) >= level && pattern.on_path(high, level) == low) related_.back().push_back(d);
    }
  }
}

// The numbers of a pair of dofs, at all points.
double* StageMatrices::at(PairMatrix& matrix, int row, int column) const {
  return matrix.at(pattern_->pair(row, column));
}

void StageMatrices::take(const StepSolution& step) {
  const int n = tree_->nv, s = stages_, S = values_.padded();
  values_.set_servo(step.servo);
  values_.set_time(step.time);
  values_.begin(step.q0, step.p0, step.h, step.tau);
  for (int d = 0; d < n; ++d)
    for (int i = 0; i < S; ++i) values_.v()[d * S + i] = step.velocities(d, std::min(i, s - 1));
  std::fill_n(values_.X(), n * S, 0.0);
  values_.settle();
  if (!balls_.empty()) values_.rates();
  for (int d = 0; d < n; ++d) {
    for (int i = 0; i < s; ++i) {
      X(d, i) = values_.X()[d * S + i];
      u(d, i) = values_.rate()[d * S + i];
    }
    X1[d] = values_.sum(values_.rate(), d);
  }
  X_points_.leftCols(s) = X;
  v_points_.leftCols(s) = step.velocities;
  if (with_nodes_) {
    X_points_.col(end()) = X1;
    v_points_.col(start()) = *step.v0;
    v_points_.col(end()) = *step.v1;
  }
  local_.evaluate(step.q0, step.p0, step.h, step.tau, step.servo, X_points_, v_points_);
  G_x = local_.G.leftCols(s);
  add_forces(step);
  if (!balls_.empty()) take_balls();
}

// What the kernel does not know: forces beyond those that are linear in a joint's coordinates.
void StageMatrices::add_forces(const StepSolution& step) {
  if (!values_.has_extra_forces()) return;
  const int S = values_.padded();
  values_.evaluate_with_forces();
  for (int i = 0; i < stages_; ++i) {
    for (int d = 0; d < tree_->nv; ++d) G_x(d, i) = values_.G()[d * S + i];
    add_split_inputs(step, i);
    add_ball_springs(step, i);
    if (field_.any()) add_elements(step, i);
  }
}

// The force R tau on a split joint, R the axes of its body.
void StageMatrices::add_split_inputs(const StepSolution& step, int stage) {
  if (step.tau.size() == 0) return;
  for (const SplitJoint& joint : tree_->split) {
    const int iv = joint.iv;
    const Mat3 R = split_axes(joint, step.q0, X.col(stage));
    const Vec3 tau(step.tau[iv], step.tau[iv + 1], joint.planar ? 0.0 : step.tau[iv + 2]);
    const Mat3 change = -R * skew(tau);
    if (joint.planar) {
      for (int r = 0; r < 2; ++r) at(K, iv + r, iv + 2)[stage] += change(r, 2);
      continue;
    }
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 3; ++c) at(K, iv + r, iv + 3 + c)[stage] += change(r, c);
  }
}

void StageMatrices::add_ball_springs(const StepSolution& step, int stage) {
  for (const int k : balls_) {
    const Joint& joint = tree_->joints[k];
    if (joint.stiffness == 0) continue;
    values_.configuration(step.q0, stage, q_);
    const Mat3 change = joint.stiffness * so3_right_jacobian_inverse(spring_deflection(*tree_, joint, q_));
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 3; ++c) at(K, joint.iv + r, joint.iv + c)[stage] -= change(r, c);
  }
}

void StageMatrices::add_elements(const StepSolution& step, int stage) {
  const int n = tree_->nv;
  values_.configuration(step.q0, stage, q_);
  v_ = step.velocities.col(stage);
  field_.take(values_.time(stage), q_, v_);
  for (int column = 0; column < n; ++column)
    for (const bool velocity : {true, false}) {
      dq_.setZero();
      dv_.setZero();
      df_.setZero();
      (velocity ? dv_ : dq_)[column] = 1.0;
      field_.add(dq_, dv_, df_);
      PairMatrix& matrix = velocity ? C : K;
      for (int row = 0; row < n; ++row)
        if (df_[row] != 0.0) at(matrix, row, column)[stage] += df_[row];
    }
}

// dv = J du + E dX and, for the turn of the body, J dX + R^T dq.
void StageMatrices::turn_columns(const Joint& joint, const std::vector<int>& dofs, int stage, const BallChart& chart) {
  using Row = Eigen::Matrix<double, 1, 3>;
  const auto get = [&](PairMatrix& matrix, int row) {
    return Row(at(matrix, row, joint.iv)[stage], at(matrix, row, joint.iv + 1)[stage],
               at(matrix, row, joint.iv + 2)[stage]);
  };
  const auto put = [&](PairMatrix& matrix, int row, const Row& x) {
    for (int c = 0; c < 3; ++c) at(matrix, row, joint.iv + c)[stage] = x[c];
  };
  for (const int row : dofs) {
    const Row m = get(M, row), b = get(B, row), c = get(C, row), k = get(K, row);
    put(M, row, m * chart.J);
    put(B, row, m * chart.E + b * chart.J);
    put(B_q, row, b * chart.R.transpose());
    put(C, row, c * chart.J);
    put(K, row, c * chart.E + k * chart.J);
    put(K_q, row, k * chart.R.transpose());
  }
}

// dY = R (dG - G x J dX): a turn of the start changes G alone.
void StageMatrices::set_balance(const Joint& joint, const std::vector<int>& dofs, int stage, const BallChart& chart) {
  const int iv = joint.iv;
  const Vec3 G(G_x(iv, stage), G_x(iv + 1, stage), G_x(iv + 2, stage));
  const Mat3 own = skew(G) * chart.J;
  const auto turn = [&](PairMatrix& from, PairMatrix& to, int column, const Mat3* less) {
    Vec3 x(at(from, iv, column)[stage], at(from, iv + 1, column)[stage], at(from, iv + 2, column)[stage]);
    if (less != nullptr && column >= iv && column < iv + 3) x -= less->col(column - iv);
    x = chart.R * x;
    for (int r = 0; r < 3; ++r) at(to, iv + r, column)[stage] = x[r];
  };
  for (const int column : dofs) {
    turn(C, C_Y, column, nullptr);
    turn(K, K_Y, column, &own);
    turn(K_q, K_Yq, column, nullptr);
  }
}

// P_x = J^T P and G_x = J^T G + E^T P.
void StageMatrices::turn_rows(const Joint& joint, const std::vector<int>& dofs, int stage, const BallChart& chart) {
  const int iv = joint.iv;
  const Mat3 Jt = chart.J.transpose(), Et = chart.E.transpose();
  const auto get = [&](PairMatrix& matrix, int column) {
    return Vec3(at(matrix, iv, column)[stage], at(matrix, iv + 1, column)[stage], at(matrix, iv + 2, column)[stage]);
  };
  const auto put = [&](PairMatrix& matrix, int column, const Vec3& x) {
    for (int r = 0; r < 3; ++r) at(matrix, iv + r, column)[stage] = x[r];
  };
  for (const int column : dofs) {
    const Vec3 m = get(M, column), b = get(B, column), b_q = get(B_q, column);
    const int own = column - iv;
    Vec3 db = Jt * b, dc = Jt * get(C, column) + Et * m, dk = Jt * get(K, column) + Et * b;
    if (own >= 0 && own < 3) {
      db += chart.H.col(own);
      dc += chart.H.row(own).transpose();
      dk += chart.N.col(own);
    }
    put(M, column, Jt * m);
    put(B, column, db);
    put(C, column, dc);
    put(K, column, dk);
    put(K_q, column, Jt * get(K_q, column) + Et * b_q);
    put(B_q, column, Jt * b_q);
  }
}

void StageMatrices::take_balls() {
  B_q = B;
  K_q = K;
  charts_.clear();
  for (const int k : balls_) {
    const int iv = tree_->joints[k].iv;
    for (int i = 0; i < stages_; ++i)
      charts_.emplace_back(X.col(i).segment<3>(iv), v_points_.col(i).segment<3>(iv), local_.P.col(i).segment<3>(iv),
                           G_x.col(i).segment<3>(iv));
  }
  const auto each = [&](auto&& turn) {
    for (std::size_t b = 0; b < balls_.size(); ++b)
      for (int i = 0; i < stages_; ++i) turn(tree_->joints[balls_[b]], related_[b], i, charts_[b * stages_ + i]);
  };
  each([&](auto&&... given) { turn_columns(given...); });
  each([&](auto&&... given) { set_balance(given...); });
  each([&](auto&&... given) { turn_rows(given...); });
  each([&](const Joint& joint, const std::vector<int>&, int i, const BallChart& chart) {
    Y.col(i).segment<3>(joint.iv) = chart.R * Vec3(G_x.col(i).segment<3>(joint.iv));
    G_x.col(i).segment<3>(joint.iv) = chart.G_x;
  });
}

}  // namespace contactvi

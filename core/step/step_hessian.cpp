#include "step/step_hessian.hpp"

#include <algorithm>

namespace contactvi {

StepHessian::StepHessian(const Tree& tree, int stages)
    : tree_(&tree),
      s_(stages),
      tangent_(tree, stages),
      adjoint_(tree, stages),
      second_(tree, adjoint_.step_.model(), stages, 2),
      curvature_(tree),
      at_{0.0, VecX(tree.nq), VecX(tree.nv), VecX(tree.nv), VecX(tree.nv)},
      lq_(tree.nv),
      lp_(tree.nv),
      source_(static_cast<std::size_t>(tree.nv) * second_.padded()),
      part_G_(source_.size()),
      part_v_(source_.size()),
      part_q_(source_.size()) {
  for (Array* array : {&stage_.X, &stage_.v, &stage_.P, &stage_.G, &stage_.mu, &stage_.momenta, &stage_.P_bar,
                       &stage_.G_bar, &stage_.turn, &stage_.v_bar, &stage_.q_bar, &stage_.X_bar, &stage_.sums})
    array->resize(static_cast<std::size_t>(tree.nv) * stages);
  for (const Joint& joint : tree.joints)
    if (joint.type == JointType::kSpherical) balls_.emplace_back(joint.iv, stages);
}

void StepHessian::take(const VecX& q0, const VecX& p0, double h, const VecX& tau, double time, const Servo* servo,
                       const MatX& velocities) {
  tangent_.take(q0, p0, h, tau, time, servo, velocities);
  adjoint_.take(q0, p0, h, tau, time, servo, velocities);
  adjoint_.step_.copy_to(second_);
  second_.work_.stiffness = nullptr;
  second_.work_.tau = nullptr;
  second_.work_.extra = nullptr;
}

bool StepHessian::solve(const StepDirection& direction, const VecCRef& lq, const VecCRef& lp, const VecCRef& dlq,
                        const VecCRef& dlp, PartialGradient& gradient, PartialGradient& change) {
  if (!adjoint_.solve(lq, lp, gradient.q, gradient.p, gradient.h, gradient.tau)) return false;
  lq_ = lq;
  lp_ = lp;
  PartialGradient ends(tree_->nv);
  take_stages(direction);
  sweep(direction, ends);
  if (!adjoint_.solve(dlq, dlp, change.q, change.p, change.h, change.tau, source_.data())) return false;
  change.q += ends.q;
  change.p += ends.p;
  change.h += ends.h;
  change.tau += ends.tau;
  return true;
}

// What the stages have, and the multipliers, with their derivatives.
void StepHessian::take_stages(const StepDirection& direction) {
  Stages& stages = tangent_.stages();
  const int S = stages.padded();
  const std::pair<Array*, const double*> arrays[] = {
      {&stage_.X, stages.X()}, {&stage_.v, stages.v()}, {&stage_.P, stages.P()}, {&stage_.G, stages.G()}};
  for (int d = 0; d < tree_->nv; ++d)
    for (int i = 0; i < s_; ++i) {
      for (const auto& [array, numbers] : arrays)
        row(*array, d)[i] = {numbers[d * S + i], tangent_.change_of(numbers)[d * S + i]};
      row(stage_.mu, d)[i] = adjoint_.mu_[d * S + i];
    }
  h_ = {stages.length(), direction.h};
  const VecX& p0 = tangent_.step().p0();
  for (auto& ball : balls_) {
    const int d = ball.dof();
    const Vec3 change = direction.p.size() > 0 ? Vec3(direction.p.segment<3>(d)) : Vec3(Vec3::Zero());
    ball.take({stages.table(), s_, h_, row(stage_.X, d), row(stage_.v, d), row(stage_.P, d), row(stage_.G, d),
               dual(p0.segment<3>(d), change)});
  }
}

// out_j = h sum_i a_ij in_i
void StepHessian::combine(const Array& in, Array& out) const {
  const GaussTable& table = second_.table();
  for (int d = 0; d < tree_->nv; ++d)
    for (int j = 0; j < s_; ++j) {
      const DualNumber* from = in.data() + static_cast<std::size_t>(d) * s_;
      DualNumber sum = 0.0;
      for (int i = 0; i < s_; ++i) sum += table.A[i][j] * from[i];
      out[static_cast<std::size_t>(d) * s_ + j] = h_ * sum;
    }
}

// The kernel's second derivatives: those of P and G along (P_bar, turn), and of them along the direction.
void StepHessian::set_kernel(const StepDirection& direction) {
  Stages& k = second_;
  const int S = k.padded();
  const long shadow = k.work_.shadow;
  const auto put = [&](double* array, const Array& numbers, const Array& along) {
    for (int d = 0; d < tree_->nv; ++d)
      for (int i = 0; i < S; ++i) {
        const std::size_t from = static_cast<std::size_t>(d) * s_ + std::min(i, s_ - 1);
        double* to = array + d * S + i;
        to[0] = numbers[from].x;
        to[shadow] = along[from].x;
        to[2 * shadow] = numbers[from].d;
        to[3 * shadow] = along[from].d;
      }
  };
  put(k.X_, stage_.X, stage_.turn);
  put(k.v_, stage_.v, stage_.P_bar);
  k.set_base_change(direction.q.size() > 0 ? direction.q : VecX(VecX::Zero(tree_->nv)), 2 * shadow);
}

// One sweep of StepAdjoint in numbers and their derivatives.
void StepHessian::sweep(const StepDirection& direction, PartialGradient& change) {
  const int n = tree_->nv, S = second_.padded();
  const GaussTable& table = second_.table();
  const auto seed = [](const VecX& l, int d) { return Dual3(Vec3(l.segment<3>(d)).cast<DualNumber>()); };
  stage_.momenta = stage_.mu;
  for (const auto& ball : balls_) ball.chart_momenta(row(stage_.mu, ball.dof()), row(stage_.momenta, ball.dof()));
  combine(stage_.momenta, stage_.sums);
  for (int d = 0; d < n; ++d)
    for (int i = 0; i < s_; ++i) {
      row(stage_.P_bar, d)[i] = -row(stage_.mu, d)[i];
      row(stage_.G_bar, d)[i] = row(stage_.sums, d)[i] + h_ * (table.b[i] * lp_[d]);
    }
  stage_.turn = stage_.G_bar;
  for (auto& ball : balls_) {
    const int d = ball.dof();
    ball.forces(row(stage_.mu, d), row(stage_.momenta, d), row(stage_.sums, d), seed(lq_, d), seed(lp_, d),
                row(stage_.P_bar, d), row(stage_.G_bar, d));
    ball.into_chart(row(stage_.G_bar, d), row(stage_.turn, d));
  }
  set_kernel(direction);
  second_.kernel().evaluate_second(&tangent_.step().model().lanes, &second_.work_);
  const long shadow = second_.work_.shadow;
  const auto get = [&](const double* array, int d, int i, bool along) {
    const double* at = array + d * S + i + (along ? shadow : 0);
    return DualNumber(at[0], at[2 * shadow]);
  };
  for (int d = 0; d < n; ++d)
    for (int i = 0; i < s_; ++i) {
      row(stage_.v_bar, d)[i] = get(second_.P_, d, i, true);
      row(stage_.q_bar, d)[i] = get(second_.G_, d, i, true);
    }
  for (const auto& ball : balls_)
    for (int i = 0; i < s_; ++i) {
      Dual3 bar, force;
      for (int d = 0; d < 3; ++d) {
        bar[d] = row(stage_.G_bar, ball.dof() + d)[i];
        force[d] = get(second_.G_, ball.dof() + d, i, false);
      }
      const Dual3 bracket = bar.cross(force);
      for (int d = 0; d < 3; ++d) row(stage_.q_bar, ball.dof() + d)[i] += bracket[d];
    }
  add_forces(direction);
  stage_.X_bar = stage_.q_bar;
  for (const auto& ball : balls_) ball.charts(row(stage_.q_bar, ball.dof()), row(stage_.X_bar, ball.dof()));
  combine(stage_.X_bar, stage_.sums);
  for (int d = 0; d < n; ++d) {
    if (adjoint_.in_ball_[d]) continue;
    for (int i = 0; i < s_; ++i) {
      row(stage_.sums, d)[i] += h_ * (table.b[i] * lq_[d]);
      row(stage_.v_bar, d)[i] += row(stage_.sums, d)[i];
    }
  }
  for (const auto& ball : balls_) ball.velocities(row(stage_.sums, ball.dof()), row(stage_.v_bar, ball.dof()));
  for (int d = 0; d < n; ++d)
    for (int i = 0; i < S; ++i) source_[d * S + i] = row(stage_.v_bar, d)[std::min(i, s_ - 1)].d;
  finish(change);
}

// The forces besides gravity: the gradients in q and v change with G_bar, and with the state.
void StepHessian::add_forces(const StepDirection& direction) {
  const int n = tree_->nv, S = second_.padded();
  for (int part = 0; part < 2; ++part) {
    part_v_.fill(0.0);
    part_q_.fill(0.0);
    for (int d = 0; d < n; ++d)
      for (int i = 0; i < S; ++i) {
        const DualNumber& bar = row(stage_.G_bar, d)[std::min(i, s_ - 1)];
        part_G_[d * S + i] = part == 0 ? bar.x : bar.d;
      }
    adjoint_.forces_.add(part_G_.data(), part_v_.data(), part_q_.data());
    for (int d = 0; d < n; ++d)
      for (int i = 0; i < s_; ++i) {
        DualNumber &v = row(stage_.v_bar, d)[i], &q = row(stage_.q_bar, d)[i];
        (part == 0 ? v.x : v.d) += part_v_[d * S + i];
        (part == 0 ? q.x : q.d) += part_q_[d * S + i];
      }
  }
  if (!curvature_.any()) return;
  const VecX& q0 = tangent_.step().q0();
  VecX of_q(n), of_v(n), bar(n);
  for (int i = 0; i < s_; ++i) {
    at_.time = tangent_.stages().time(i);
    tangent_.stages().configuration(q0, i, at_.q);
    tangent_.configuration_change(i, at_.dq);
    for (int d = 0; d < n; ++d) {
      at_.v[d] = row(stage_.v, d)[i].x;
      at_.dv[d] = row(stage_.v, d)[i].d;
      bar[d] = row(stage_.G_bar, d)[i].x;
    }
    of_q.setZero();
    of_v.setZero();
    curvature_.add(at_, tangent_.step().tau(), direction.tau, bar, of_q, of_v);
    for (int d = 0; d < n; ++d) {
      row(stage_.q_bar, d)[i].d += of_q[d];
      row(stage_.v_bar, d)[i].d += of_v[d];
    }
  }
}

// What the gradients change by at constant multipliers.
void StepHessian::finish(PartialGradient& change) {
  const int n = tree_->nv, S = second_.padded();
  DualNumber by_length = 0.0;  // h times the gradient in h
  for (int d = 0; d < n; ++d) {
    if (adjoint_.in_ball_[d]) continue;
    for (int i = 0; i < s_; ++i) {
      change.q[d] += row(stage_.q_bar, d)[i].d;
      by_length += row(stage_.G_bar, d)[i] * row(stage_.G, d)[i] + row(stage_.sums, d)[i] * row(stage_.v, d)[i];
    }
  }
  for (const auto& ball : balls_) {
    const int d = ball.dof();
    Dual3 lq, lp;
    ball.start(row(stage_.q_bar, d), Vec3(lq_.segment<3>(d)).cast<DualNumber>(), lq, lp);
    change.q.segment<3>(d) += derivative(lq);
    change.p.segment<3>(d) += derivative(lp);
    by_length += ball.length(row(stage_.sums, d));
  }
  change.h = (by_length / h_).d;
  for (int d = 0; d < n; ++d)
    for (int i = 0; i < S; ++i) part_G_[d * S + i] = row(stage_.G_bar, d)[std::min(i, s_ - 1)].d;
  adjoint_.forces_.inputs(part_G_.data(), change.tau);
  if (tree_->split.empty()) return;
  const VecX& q0 = tangent_.step().q0();
  VecX bar(n);
  for (int i = 0; i < s_; ++i) {
    tangent_.stages().configuration(q0, i, at_.q);
    tangent_.configuration_change(i, at_.dq);
    for (int d = 0; d < n; ++d) bar[d] = row(stage_.G_bar, d)[i].x;
    curvature_.add_inputs(at_, bar, change.tau);
  }
}

}  // namespace contactvi

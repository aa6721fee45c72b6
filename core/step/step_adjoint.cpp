#include "step/step_adjoint.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "model/coupling.hpp"
#include "step/rounding_stop.hpp"

namespace contactvi {

StepAdjoint::StepAdjoint(const Tree& tree, int stages)
    : tree_(&tree),
      step_(tree, stages),
      stages_(tree, step_.model(), stages, 1),
      node_(tree, step_.model(), 1, 1),
      forces_(tree, stages),
      rates_(tree),
      parameters_(tree),
      in_ball_(tree.nv, 0),
      weights_(static_cast<std::size_t>(stages) * stages_.padded()),
      hb_(stages_.padded()),
      mu_(static_cast<std::size_t>(tree.nv) * stages_.padded()),
      px_bar_(mu_.size()),
      G_bar_(mu_.size()),
      X_bar_(mu_.size()),
      sums_(mu_.size()),
      v_bar_(mu_.size()),
      lq_(tree.nv),
      lp_(tree.nv) {
  for (const Joint& joint : tree.joints) {
    if (joint.type != JointType::kSpherical) continue;
    balls_.emplace_back(joint.iv, stages);
    std::fill_n(in_ball_.begin() + joint.iv, 3, 1);
  }
}

void StepAdjoint::take(const VecX& q0, const VecX& p0, double h, const VecX& tau, double time, const Servo* servo,
                       const MatX& velocities) {
  has_matrix_ = false;
  rates_.forget();
  step_.take(q0, p0, h, tau, time, servo, velocities);
  step_.copy_to(stages_);
  stages_.work_.stiffness = nullptr;
  stages_.work_.tau = nullptr;
  stages_.work_.extra = nullptr;
  const int S = stages_.padded(), s = stages_.count();
  for (int i = 0; i < s; ++i)
    for (int j = 0; j < S; ++j) weights_[i * S + j] = h * stages_.table().A[i][std::min(j, s - 1)];
  for (int j = 0; j < S; ++j) hb_[j] = h * stages_.table().b[std::min(j, s - 1)];
  forces_.take(step_);
  const Stages& at = step_.stages();
  for (BallAdjoint& ball : balls_) {
    const int row = ball.dof() * S;
    ball.take({at.table(), S, h, at.X() + row, at.v() + row, at.P() + row, at.G() + row, p0.segment<3>(ball.dof())});
  }
}

void StepAdjoint::momentum(const VecCRef& q, const VecCRef& v, const VecCRef& lp, VecRef lq, VecRef lv) {
  node_.at(q);
  const int S = node_.padded();
  const long to_shadow = node_.work_.shadow;
  for (int d = 0; d < tree_->nv; ++d)
    for (int i = 0; i < S; ++i) {
      node_.v_[d * S + i] = v[d];
      node_.v_[d * S + i + to_shadow] = lp[d];
    }
  node_.kernel().evaluate_tangent(&step_.model().lanes, &node_.work_);
  for (int d = 0; d < tree_->nv; ++d) {
    lv[d] = node_.P_[d * S + to_shadow];
    lq[d] = node_.G_[d * S + to_shadow];
  }
  if (tree_->lent_armature.size() > 0) lv -= tree_->lent_armature.cwiseProduct(lp);
}

void StepAdjoint::set_seed(const VecCRef& lq, const VecCRef& lp) {
  lq_ = lq;
  lp_ = lp;
  follow_velocity(*tree_, lp_);  // of a momentum only S^T p has a meaning
  mu_.fill(0.0);
}

// out_j = h sum_i a_ij in_i
void StepAdjoint::combine(const double* in, double* out) const {
  stages_.kernel().combine(tree_->nv, stages_.count(), stages_.padded(), weights_.data(), in, out, false);
}

// All gradients from the multipliers mu.
void StepAdjoint::sweep() {
  const int S = stages_.padded(), n = tree_->nv, size = n * S;
  double *P_bar = shadow(stages_.v_), *turn = shadow(stages_.X_), *mu = mu_.data();
  double *v_bar = shadow(stages_.P_), *q_bar = shadow(stages_.G_);
  double* G_bar = G_bar_.data();
  // Gradients in the momenta: mu itself but on spherical joints.
  const double* momenta = mu;
  if (!balls_.empty()) {
    std::copy_n(mu, size, px_bar_.data());
    for (const BallAdjoint& ball : balls_) ball.chart_momenta(mu + ball.dof() * S, px_bar_.data() + ball.dof() * S);
    momenta = px_bar_.data();
  }
  combine(momenta, sums_.data());
  for (int at = 0; at < size; ++at) P_bar[at] = -mu[at];
  for (int d = 0; d < n; ++d)
    for (int i = 0; i < S; ++i) G_bar[d * S + i] = sums_[d * S + i] + hb_[i] * lp_[d];
  std::copy_n(G_bar, size, turn);
  for (BallAdjoint& ball : balls_) {
    const int d = ball.dof(), at = d * S;
    ball.forces(mu + at, momenta + at, &sums_[at], lq_.segment<3>(d), lp_.segment<3>(d), P_bar + at, G_bar + at);
    ball.into_chart(G_bar + at, turn + at);
  }
  stages_.kernel().evaluate_tangent(&step_.model().lanes, &stages_.work_);
  for (const BallAdjoint& ball : balls_) {
    const int x = ball.dof() * S, y = x + S, z = y + S;
    const double* G = stages_.G_;
    for (int i = 0; i < S; ++i) {
      q_bar[x + i] += G_bar[y + i] * G[z + i] - G_bar[z + i] * G[y + i];
      q_bar[y + i] += G_bar[z + i] * G[x + i] - G_bar[x + i] * G[z + i];
      q_bar[z + i] += G_bar[x + i] * G[y + i] - G_bar[y + i] * G[x + i];
    }
  }
  forces_.add(G_bar, v_bar, q_bar);
  const double* X_bar = q_bar;
  if (!balls_.empty()) {
    std::copy_n(q_bar, size, X_bar_.data());
    for (const BallAdjoint& ball : balls_) ball.charts(q_bar + ball.dof() * S, &X_bar_[ball.dof() * S]);
    X_bar = X_bar_.data();
  }
  combine(X_bar, sums_.data());
  for (int d = 0; d < n; ++d) {
    if (in_ball_[d]) continue;
    for (int i = 0; i < S; ++i) sums_[d * S + i] += hb_[i] * lq_[d];
  }
  for (int at = 0; at < size; ++at) v_bar_[at] = v_bar[at] + sums_[at];
  for (const BallAdjoint& ball : balls_) {
    const int at = ball.dof() * S;
    std::copy_n(v_bar + at, 3 * S, &v_bar_[at]);
    ball.velocities(&sums_[at], &v_bar_[at]);
  }
  if (source_ == nullptr) return;
  for (int at = 0; at < size; ++at) v_bar_[at] += source_[at];
}

// False where the iterations do not contract.
bool StepAdjoint::iterate() {
  const int size = tree_->nv * stages_.padded();
  RoundingStop stop;
  for (;;) {
    sweep();
    ++iterations_;
    double* correction = step_.stages().dv();
    std::copy_n(v_bar_.data(), size, correction);
    step_.solve_transposed();
    double change = 0.0, largest = 0.0;
    for (int i = 0; i < size; ++i) {
      mu_[i] += correction[i];
      change = std::max(change, std::abs(correction[i]));
      largest = std::max(largest, std::abs(mu_[i]));
    }
    const RoundingStop::Verdict verdict = stop.judge(change, largest);
    if (verdict != RoundingStop::Verdict::kGoOn) return verdict == RoundingStop::Verdict::kSolved;
  }
}

// With the matrix of the equations, made column by column.
bool StepAdjoint::solve_by_matrix() {
  const int S = stages_.padded(), s = stages_.count(), n = tree_->nv, size = n * s;
  const auto add = [&](int i, int d, double x) {
    for (int k = i; k < (i + 1 == s ? S : i + 1); ++k) mu_[d * S + k] += x;
  };
  const auto residual = [&] {
    sweep();
    VecX r(size);
    for (int i = 0; i < s; ++i) {
      for (int d = 0; d < n; ++d) r[i * n + d] = v_bar_[d * S + i];
      // Of coupled joints S^T r, and multipliers that follow as velocities do.
      if (tree_->followers.empty()) continue;
      fold_momentum(*tree_, r.segment(i * n, n));
      for (const Follower& f : tree_->followers) {
        r[i * n + f.iv] = mu_[f.iv * S + i];
        for (const Follower::Leader& leader : f.leaders) r[i * n + f.iv] -= leader.ratio * mu_[leader.iv * S + i];
      }
    }
    return r;
  };
  const VecX lq = lq_, lp = lp_;
  const double* source = std::exchange(source_, nullptr);  // the matrix is without it
  if (!has_matrix_) {
    MatX matrix(size, size);
    for (int i = 0; i < s; ++i)
      for (int d = 0; d < n; ++d) {
        set_seed(VecX::Zero(n), VecX::Zero(n));
        add(i, d, 1.0);
        matrix.col(i * n + d) = residual();
      }
    matrix_.compute(matrix);
    has_matrix_ = true;
  }
  set_seed(lq, lp);
  source_ = source;
  for (int pass = 0; pass < 3; ++pass) {  // the first solves, the others take the rounding off
    const VecX change = matrix_.solve(residual());
    if (!change.allFinite()) return false;
    for (int i = 0; i < s; ++i)
      for (int d = 0; d < n; ++d) add(i, d, -change[i * n + d]);
  }
  iterations_ = 0;
  return true;
}

bool StepAdjoint::solve(const VecCRef& lq, const VecCRef& lp, VecRef lq0, VecRef lp0, double& lh, VecRef ltau,
                        const double* source) {
  iterations_ = 0;
  source_ = source;
  set_seed(lq, lp);
  if ((has_matrix_ || !iterate()) && !solve_by_matrix()) return false;
  sweep();  // at the last multipliers
  finish(lq0, lp0, lh, ltau);
  return lq0.allFinite() && lp0.allFinite() && std::isfinite(lh) && ltau.allFinite();
}

void StepAdjoint::add_time(double& lt, double& lh) {
  if (!rates_.any()) return;
  const MatX& rates = rates_.of(step_);
  const int S = stages_.padded();
  for (int i = 0; i < stages_.count(); ++i) {
    double at_stage = 0.0;
    for (int d = 0; d < tree_->nv; ++d) at_stage += G_bar_[d * S + i] * rates(d, i);
    lt += at_stage;
    lh += stages_.table().c[i] * at_stage;
  }
}

void StepAdjoint::take_multipliers(const MatX& mu, const VecCRef& lq, const VecCRef& lp) {
  const int S = stages_.padded(), s = stages_.count();
  source_ = nullptr;
  set_seed(lq, lp);
  for (int i = 0; i < S; ++i) {
    VecX own = mu.col(std::min(i, s - 1));
    follow_velocity(*tree_, own);
    for (int d = 0; d < tree_->nv; ++d) mu_[d * S + i] = own[d];
  }
  sweep();
}

void StepAdjoint::finish(VecRef lq0, VecRef lp0, double& lh, VecRef ltau) {
  const int S = stages_.padded(), s = stages_.count();
  const Stages& at_solution = step_.stages();
  const double* q_bar = shadow(stages_.G_);
  double by_length = 0.0;  // h times the gradient in h
  for (int d = 0; d < tree_->nv; ++d) {
    if (in_ball_[d]) continue;
    lq0[d] = lq_[d];
    lp0[d] = lp_[d];
    for (int i = 0; i < s; ++i) {
      const int at = d * S + i;
      lq0[d] += q_bar[at];
      lp0[d] += mu_[at];
      by_length += G_bar_[at] * at_solution.G()[at] + sums_[at] * at_solution.v()[at];
    }
  }
  for (const BallAdjoint& ball : balls_) {
    const int d = ball.dof();
    Vec3 lq, lp;
    ball.start(q_bar + d * S, lq_.segment<3>(d), lq, lp);
    lq0.segment<3>(d) = lq;
    lp0.segment<3>(d) = lp;
    by_length += ball.length(&sums_[d * S]);
  }
  lh = by_length / stages_.length();
  forces_.inputs(G_bar_.data(), ltau);
}

void StepAdjoint::add_parameters(StepParameters& sums) {
  const int S = stages_.padded(), n = tree_->nv;
  VecX q(tree_->nq), v(n), P_bar(n), G_bar(n);
  for (int i = 0; i < stages_.count(); ++i) {
    stages_.configuration(step_.q0(), i, q);
    for (int d = 0; d < n; ++d) {
      v[d] = stages_.v_[d * S + i];
      P_bar[d] = shadow(stages_.v_)[d * S + i];
      G_bar[d] = G_bar_[d * S + i];
    }
    parameters_.add_state(q, v, P_bar, G_bar, sums);
    parameters_.add_forces(step_.stages(), step_.q0(), i, G_bar, sums);
  }
}

void StepAdjoint::add_momentum_parameters(const VecCRef& q, const VecCRef& v, const VecCRef& lp, StepParameters& sums) {
  parameters_.add_state(q, v, lp, VecX::Zero(tree_->nv), sums);
}

}  // namespace contactvi

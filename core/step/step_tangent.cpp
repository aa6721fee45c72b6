#include "step/step_tangent.hpp"

#include <algorithm>
#include <cmath>

#include "model/coordinates.hpp"
#include "model/coupling.hpp"
#include "step/rounding_stop.hpp"

namespace contactvi {

namespace {
// Of the charts of spherical joints along a direction, whose displacements depend on themselves.
constexpr int kTangentIterations = 30;
const StepDirection kNoDirection;
}  // namespace

StepTangent::StepTangent(const Tree& tree, int stages)
    : tree_(&tree),
      step_(tree, stages),
      stages_(tree, step_.model(), stages, 1),
      node_(tree, step_.model(), 1, 1),
      field_(tree),
      rates_(tree),
      parameters_(tree),
      q_(tree.nq),
      v_(tree.nv),
      dq_(tree.nv),
      dv_(tree.nv),
      df_(tree.nv),
      r_(static_cast<Eigen::Index>(tree.nv) * stages),
      dtau_(VecX::Zero(tree.nv)) {}

void StepTangent::take(const VecX& q0, const VecX& p0, double h, const VecX& tau, double time, const Servo* servo,
                       const MatX& velocities) {
  has_matrix_ = false;
  rates_.forget();
  step_.take(q0, p0, h, tau, time, servo, velocities);
  step_.copy_to(stages_);
  stages_.clear_impulse();
  // The input has a derivative also where there is none.
  if (stages_.work_.tau == nullptr) {
    std::fill_n(stages_.input_, tree_->nv, 0.0);
    stages_.work_.tau = stages_.input_;
  }
  stages_.work_.extra = &StepTangent::add_extra;
  stages_.work_.context = this;
}

void StepTangent::add_impulses(const MatX& impulses) {
  double* given = stages_.impulse();
  const int S = stages_.padded(), s = stages_.count();
  for (int d = 0; d < tree_->nv; ++d)
    for (int i = 0; i < S; ++i) given[d * S + i] = impulses(d, std::min(i, s - 1));
}

void StepTangent::momentum(const VecCRef& q, const VecCRef& v, const VecCRef& dq, const VecCRef& dv, VecRef dp) {
  node_.at(q);
  const int S = node_.padded();
  std::fill_n(node_.memory_.data() + node_.work_.shadow, node_.work_.shadow, 0.0);
  node_.set_base_change(dq, node_.work_.shadow);
  for (int d = 0; d < tree_->nv; ++d)
    for (int i = 0; i < S; ++i) {
      node_.v_[d * S + i] = v[d];
      node_.v_[d * S + i + node_.work_.shadow] = dv[d];
    }
  node_.kernel().evaluate_tangent(&step_.model().lanes, &node_.work_);
  for (int d = 0; d < tree_->nv; ++d) dp[d] = node_.P_[d * S + node_.work_.shadow];
  if (tree_->lent_armature.size() > 0) dp -= tree_->lent_armature.cwiseProduct(dv);
}

MatX StepTangent::momentum_changes(const VecCRef& q, const VecCRef& v) {
  const int n = tree_->nv;
  const VecX none = VecX::Zero(n);
  MatX found(n, n);
  for (int k = 0; k < n; ++k) momentum(q, v, VecX::Unit(n, k), none, found.col(k));
  return found;
}

void StepTangent::velocity_change(int stage, VecRef dv) const {
  const int S = stages_.padded();
  for (int d = 0; d < tree_->nv; ++d) dv[d] = shadow(stages_.v_)[d * S + stage];
}

bool StepTangent::unit_changes(const Eigen::Ref<const MatX>& W, MatX& Q, MatX& P, MatX& V) {
  for (MatX* X : {&Q, &P, &V}) X->resize(W.rows(), W.cols());
  StepDirection unit;
  for (Eigen::Index k = 0; k < W.cols(); ++k) {
    unit.p = W.col(k);
    if (!solve(unit, Q.col(k), P.col(k))) return false;
    velocity_change(0, V.col(k));
  }
  return true;
}

void StepTangent::configuration_change(int stage, VecRef dq) const {
  const int S = stages_.padded();
  for (int d = 0; d < tree_->nv; ++d)
    dq[d] = shadow(stages_.X_)[d * S + stage] + (direction_.q.size() > 0 ? direction_.q[d] : 0.0);
  for (const Joint& joint : tree_->joints)
    if (joint.type == JointType::kSpherical) dq.segment<3>(joint.iv) = ball_turn(joint, stage);
}

// dE = v . dP - dL/dq . dq, for E = P . v - L.
double StepTangent::energy_change() const {
  const Stages& s = stages_;
  const int S = s.padded();
  const VecX& q = direction_.q;
  double total = 0.0;
  for (int i = 0; i < s.count(); ++i) {
    double change = 0.0;
    for (const Joint& joint : tree_->joints) {
      Vec3 turn = Vec3::Zero();
      if (joint.type == JointType::kSpherical) turn = ball_turn(joint, i);
      for (int k = 0; k < joint.nv; ++k) {
        const int d = joint.iv + k;
        double moved = turn[k];
        if (joint.type != JointType::kSpherical) moved = shadow(s.X_)[d * S + i] + (q.size() > 0 ? q[d] : 0.0);
        change += s.v_[d * S + i] * shadow(s.P_)[d * S + i] - s.G_[d * S + i] * moved;
      }
    }
    total += s.table().b[i] * change;
  }
  return total;
}

void StepTangent::set_direction(const StepDirection& direction) {
  direction_ = direction;
  Stages& s = stages_;
  const int n = tree_->nv, S = s.padded();
  std::fill_n(s.memory_.data() + s.work_.shadow, s.work_.shadow, 0.0);
  if (direction.parameters != nullptr) set_parameters();
  if (direction.p.size() > 0) std::copy_n(direction.p.data(), n, shadow(s.p0_));
  if (direction.q.size() > 0) {
    s.set_base_change(direction.q, s.work_.shadow);
    for (int d = 0; d < n; ++d)
      if (s.stiffness_[d] != 0.0) shadow(s.deflection_)[d] = direction.q[d];
  }
  if (direction.h != 0.0) {
    const GaussTable& table = s.table();
    for (int j = 0; j < s.count(); ++j) {
      shadow(s.hb_)[j] = direction.h * table.b[j];
      for (int i = 0; i < S; ++i) shadow(s.hA_)[j * S + i] = direction.h * table.A[std::min(i, s.count() - 1)][j];
    }
  }
  if (direction.impulses.size() > 0) {
    double* given = shadow(s.impulse());
    for (int d = 0; d < n; ++d)
      for (int i = 0; i < S; ++i) given[d * S + i] = direction.impulses(d, std::min(i, s.count() - 1));
  }
  if (direction.tau.size() > 0) {
    dtau_ = direction.tau;
    for (int d = 0; d < n; ++d) shadow(s.input_)[d] = direction.tau[d];
    for (const SplitJoint& joint : tree_->split)
      for (int d = 0; d < (joint.planar ? 2 : 3); ++d) shadow(s.input_)[joint.iv + d] = 0.0;
  } else {
    dtau_.setZero();
  }
}

void StepTangent::evaluate() { stages_.kernel().tangent(&step_.model().lanes, &stages_.work_); }

// Of the stage equations along the direction, stage by stage.
void StepTangent::residual(VecRef r) const {
  const int S = stages_.padded(), n = tree_->nv;
  const double* dr = shadow(stages_.dv_);
  for (int i = 0; i < stages_.count(); ++i) {
    for (int d = 0; d < n; ++d) r[i * n + d] = dr[d * S + i];
    // Of coupled joints S^T r, and that the followers follow.
    if (tree_->followers.empty()) continue;
    fold_momentum(*tree_, r.segment(i * n, n));
    for (const Follower& f : tree_->followers) {
      double off = shadow(stages_.v_)[f.iv * S + i];
      for (const Follower::Leader& leader : f.leaders) off -= leader.ratio * shadow(stages_.v_)[leader.iv * S + i];
      r[i * n + f.iv] = off;
    }
  }
}

// False where the iterations do not contract.
bool StepTangent::iterate() {
  const int S = stages_.padded(), n = tree_->nv, size = n * S;
  double* dv = shadow(stages_.v_);
  RoundingStop stop;
  for (;;) {
    evaluate();
    ++iterations_;
    double* correction = step_.stages().dv();
    std::copy_n(shadow(stages_.dv_), size, correction);
    step_.solve();
    double change = 0.0, largest = 0.0;
    for (int i = 0; i < size; ++i) {
      dv[i] += correction[i];
      change = std::max(change, std::abs(correction[i]));
      largest = std::max(largest, std::abs(dv[i]));
    }
    const RoundingStop::Verdict verdict = stop.judge(change, largest);
    if (verdict != RoundingStop::Verdict::kGoOn) return verdict == RoundingStop::Verdict::kSolved;
  }
}

// With the matrix of the equations, made column by column.
bool StepTangent::solve_by_matrix() {
  const int S = stages_.padded(), s = stages_.count(), n = tree_->nv, size = n * s;
  const StepDirection wanted = direction_;
  // The displacements of spherical joints follow the velocities by a contraction of their own.
  const auto settle = [&] {
    for (int k = 0; k < (step_.model().lanes.balls > 0 ? kTangentIterations : 1); ++k) evaluate();
    residual(r_);
  };
  if (!has_matrix_) {
    MatX matrix(size, size);
    for (int i = 0; i < s; ++i)
      for (int d = 0; d < n; ++d) {
        set_direction(kNoDirection);
        for (int k = i; k < (i + 1 == s ? S : i + 1); ++k) shadow(stages_.v_)[d * S + k] = 1.0;
        settle();
        matrix.col(i * n + d) = r_;
      }
    matrix_.compute(matrix);
    has_matrix_ = true;
  }
  set_direction(wanted);
  for (int pass = 0; pass < 3; ++pass) {  // the first solves, the others take the rounding off
    settle();
    const VecX change = matrix_.solve(r_);
    if (!change.allFinite()) return false;
    for (int i = 0; i < s; ++i)
      for (int d = 0; d < n; ++d)
        for (int k = i; k < (i + 1 == s ? S : i + 1); ++k) shadow(stages_.v_)[d * S + k] -= change[i * n + d];
  }
  settle();
  iterations_ = 0;
  return true;
}

bool StepTangent::solve(const StepDirection& direction, VecRef dq1, VecRef dp1) {
  iterations_ = 0;
  set_direction(direction);
  if (has_matrix_ || !iterate()) {
    set_direction(direction);
    if (!solve_by_matrix()) return false;
  }
  evaluate();  // G at the last velocities
  finish(direction, dq1, dp1);
  return dq1.allFinite() && dp1.allFinite();
}

void StepTangent::keep(MatX& dv, MatX& dX) const {
  const int S = stages_.padded(), s = stages_.count();
  dv.resize(tree_->nv, s);
  dX.resize(tree_->nv, s);
  for (int d = 0; d < tree_->nv; ++d)
    for (int i = 0; i < s; ++i) {
      dv(d, i) = shadow(stages_.v_)[d * S + i];
      dX(d, i) = shadow(stages_.X_)[d * S + i];
    }
}

void StepTangent::resume(const StepDirection& direction, const MatX& dv, const MatX& dX) {
  const int S = stages_.padded(), s = stages_.count();
  set_direction(direction);
  for (int d = 0; d < tree_->nv; ++d)
    for (int i = 0; i < S; ++i) {
      shadow(stages_.v_)[d * S + i] = dv(d, std::min(i, s - 1));
      shadow(stages_.X_)[d * S + i] = dX(d, std::min(i, s - 1));
    }
  evaluate();
}

void StepTangent::finish(const StepDirection& direction, VecRef dq1, VecRef dp1) {
  Stages& s = stages_;
  const int S = s.padded();
  const auto sum = [&](const double* in, int dof) {
    const double *row = in + dof * S, *change = shadow(row);
    double total = 0.0;
    for (int j = 0; j < s.count(); ++j) total += s.hb_[j] * change[j] + shadow(s.hb_)[j] * row[j];
    return total;
  };
  const auto sum3 = [&](const double* in, int dof) { return Vec3(sum(in, dof), sum(in, dof + 1), sum(in, dof + 2)); };
  if (direction.q.size() > 0) {
    dq1 = direction.q;
  } else {
    dq1.setZero();
  }
  if (direction.p.size() > 0) {
    dp1 = direction.p;
  } else {
    dp1.setZero();
  }
  if (step_.model().lanes.balls > 0) s.rates();
  for (const Joint& joint : tree_->joints) {
    const int iv = joint.iv;
    if (joint.type != JointType::kSpherical) {
      for (int d = iv; d < iv + joint.nv; ++d) {
        dq1[d] += sum(s.v_, d);
        dp1[d] += sum(s.G_, d);
      }
      continue;
    }
    // q1 = q0 exp(X), p1 = exp(-X) (p0 + sum): the body of q1 has turned by exp(-X) dq0 + J_r(X) dX.
    const Vec3 X(s.sum(s.work_.rate, iv), s.sum(s.work_.rate, iv + 1), s.sum(s.work_.rate, iv + 2));
    const Vec3 dX = sum3(s.work_.rate, iv);
    const So3Coefficients k = so3_coefficients(X.squaredNorm());
    const Vec3 own = so3_apply(-X, k.cos_t, k.cub_t, dX);
    const Vec3 total = step_.p0().segment<3>(iv) + Vec3(s.sum(s.Y_, iv), s.sum(s.Y_, iv + 1), s.sum(s.Y_, iv + 2));
    const Vec3 p1 = so3_apply(-X, k.sin_t, k.cos_t, total);
    const Vec3 change = dp1.segment<3>(iv) + sum3(s.Y_, iv);
    dq1.segment<3>(iv) = so3_apply(-X, k.sin_t, k.cos_t, Vec3(dq1.segment<3>(iv))) + own;
    dp1.segment<3>(iv) = so3_apply(-X, k.sin_t, k.cos_t, change) - own.cross(p1);
  }
  fold_momentum(*tree_, dp1);
}

// What the body of a spherical joint turns by at a stage along the direction, body frame.
Vec3 StepTangent::ball_turn(const Joint& joint, int i) const {
  const int S = stages_.padded(), iv = joint.iv;
  const double *X = stages_.X_, *dX = shadow(X);
  const Vec3 x(X[iv * S + i], X[(iv + 1) * S + i], X[(iv + 2) * S + i]);
  const Vec3 dx(dX[iv * S + i], dX[(iv + 1) * S + i], dX[(iv + 2) * S + i]);
  const So3Coefficients k = so3_coefficients(x.squaredNorm());
  Vec3 turn = so3_apply(-x, k.cos_t, k.cub_t, dx);
  if (direction_.q.size() > 0) turn += so3_apply(-x, k.sin_t, k.cos_t, Vec3(direction_.q.segment<3>(joint.iv)));
  return turn;
}

void StepTangent::add_extra(void* self) {
  StepTangent& t = *static_cast<StepTangent*>(self);
  t.stages_.add_forces();
  if (!t.tree_->split.empty()) t.add_split_inputs();
  if (t.stages_.has_ball_springs_) t.add_ball_springs();
  if (t.field_.any()) t.add_elements();
  if (t.rates_.any()) t.add_force_rates();
  if (t.direction_.parameters != nullptr) t.add_parameters();
}

// The force R tau on a split joint, R the axes of its body.
void StepTangent::add_split_inputs() {
  Stages& s = stages_;
  const bool inputs = s.has_inputs_;
  if (!inputs && direction_.tau.size() == 0) return;
  const VecX& q0 = step_.q0();
  const int S = s.padded();
  for (int i = 0; i < S; ++i)
    for (const SplitJoint& joint : tree_->split) {
      const int iv = joint.iv, iq = joint.iq, stage = std::min(i, s.count() - 1);
      const Vec3 tau = inputs ? Vec3(s.tau_[iv], s.tau_[iv + 1], joint.planar ? 0.0 : s.tau_[iv + 2]) : Vec3::Zero();
      const Vec3 dtau(dtau_[iv], dtau_[iv + 1], joint.planar ? 0.0 : dtau_[iv + 2]);
      Vec3 change;
      if (joint.planar) {
        const double angle = s.X_[(iv + 2) * S + i], c0 = q0[iq + 2], s0 = q0[iq + 3];
        const double c = c0 * std::cos(angle) - s0 * std::sin(angle), n = s0 * std::cos(angle) + c0 * std::sin(angle);
        const double turn = shadow(s.X_)[(iv + 2) * S + i] + (direction_.q.size() > 0 ? direction_.q[iv + 2] : 0.0);
        const double x = dtau[0] - turn * tau[1], y = dtau[1] + turn * tau[0];
        change = Vec3(c * x - n * y, n * x + c * y, 0.0);
      } else {
        const Quat quat(q0[iq + 6], q0[iq + 3], q0[iq + 4], q0[iq + 5]);
        const Vec3 X(s.X_[(iv + 3) * S + i], s.X_[(iv + 4) * S + i], s.X_[(iv + 5) * S + i]);
        const Joint& ball = tree_->joints[tree_->dof_joint[iv + 3]];
        change = quat * (so3_exp(X) * Vec3(dtau + ball_turn(ball, stage).cross(tau)));
      }
      for (int d = 0; d < (joint.planar ? 2 : 3); ++d) shadow(s.G_)[(iv + d) * S + i] += change[d];
    }
}

void StepTangent::add_ball_springs() {
  Stages& s = stages_;
  const int S = s.padded();
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical || joint.stiffness == 0) continue;
    const int iv = joint.iv;
    const VecX& q0 = step_.q0();
    q_ = q0;
    for (int i = 0; i < S; ++i) {
      const Vec3 X(s.X_[iv * S + i], s.X_[(iv + 1) * S + i], s.X_[(iv + 2) * S + i]);
      const Quat start(q0[joint.iq + 3], q0[joint.iq], q0[joint.iq + 1], q0[joint.iq + 2]);
      q_.segment<4>(joint.iq) = (start * so3_exp(X)).coeffs();
      const Vec3 deflection = spring_deflection(*tree_, joint, q_);
      const Vec3 change = joint.stiffness * (so3_right_jacobian_inverse(deflection) * ball_turn(joint, i));
      for (int d = 0; d < 3; ++d) shadow(s.G_)[(iv + d) * S + i] -= change[d];
    }
  }
}

void StepTangent::add_momentum(const VecCRef& q, const VecCRef& v, const StepParameters& parameters, VecRef dp) {
  VecX dG = VecX::Zero(tree_->nv);
  parameters_.add_state(q, v, parameters, dp, dG);
}

void StepTangent::set_parameters() {
  const int S = stages_.padded(), n = tree_->nv;
  parameter_P_.setZero(n, stages_.count());
  parameter_G_.setZero(n, stages_.count());
  for (int i = 0; i < stages_.count(); ++i) {
    stages_.configuration(step_.q0(), i, q_);
    for (int d = 0; d < n; ++d) v_[d] = stages_.v_[d * S + i];
    parameters_.add_state(q_, v_, *direction_.parameters, parameter_P_.col(i), parameter_G_.col(i));
    parameters_.add_forces(stages_, step_.q0(), i, *direction_.parameters, parameter_G_.col(i));
  }
}

void StepTangent::add_parameters() {
  const int S = stages_.padded(), s = stages_.count();
  for (int d = 0; d < tree_->nv; ++d)
    for (int i = 0; i < S; ++i) {
      shadow(stages_.P_)[d * S + i] += parameter_P_(d, std::min(i, s - 1));
      shadow(stages_.G_)[d * S + i] += parameter_G_(d, std::min(i, s - 1));
    }
}

// The time of a stage moves with the start and with the length.
void StepTangent::add_force_rates() {
  const double t = direction_.t, h = direction_.h;
  if (t == 0.0 && h == 0.0) return;
  const MatX& rates = rates_.of(step_);
  const int S = stages_.padded(), s = stages_.count();
  for (int d = 0; d < tree_->nv; ++d)
    for (int k = 0; k < S; ++k) {
      const int i = std::min(k, s - 1);
      shadow(stages_.G_)[d * S + k] += (t + stages_.table().c[i] * h) * rates(d, i);
    }
}

void StepTangent::add_elements() {
  Stages& s = stages_;
  const int S = s.padded(), n = tree_->nv;
  for (int i = 0; i < s.count(); ++i) {
    s.configuration(step_.q0(), i, q_);
    for (int d = 0; d < n; ++d) {
      v_[d] = s.v_[d * S + i];
      dv_[d] = shadow(s.v_)[d * S + i];
    }
    configuration_change(i, dq_);
    df_.setZero();
    field_.take(s.time(i), q_, v_);
    field_.add(dq_, dv_, df_);
    for (int d = 0; d < n; ++d)
      for (int k = i; k < (i + 1 == s.count() ? S : i + 1); ++k) shadow(s.G_)[d * S + k] += df_[d];
  }
}

}  // namespace contactvi

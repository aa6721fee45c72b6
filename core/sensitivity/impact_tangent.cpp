#include "sensitivity/impact_tangent.hpp"

#include <cmath>

#include "step/energy.hpp"

namespace contactvi {

namespace {
// Of the impulse: nearer to a change between sticking and slipping than this, rounding decides the active set.
constexpr double kOnCone = 1e-9;
// Of the momenta: to which a recorded impact is the one that is differentiated.
constexpr double kSameImpulse = 1e-7;

ImpactOptions options_of(const RecordedRun& run) {
  ImpactOptions options;
  options.map = run.map;
  options.dt = run.dt;
  options.record_contacts = false;
  return options;
}
}  // namespace

ImpactTangent::ImpactTangent(const Scene& scene, const RecordedRun& run)
    : scene_(&scene),
      run_(&run),
      integrator_(scene.tree, run.stages, run.tol, 200),
      guards_(scene, run.contact_points),
      sequence_(scene, integrator_, guards_, options_of(run)),
      contact_(scene),
      rest_(scene.tree, run.stages),
      u_(scene.tree.nv),
      work_(scene.tree.nv),
      q1_(scene.tree.nq),
      p1_(scene.tree.nv),
      v1_(scene.tree.nv),
      force1_(scene.tree.nv),
      dq1_(scene.tree.nv),
      dp1_(scene.tree.nv) {}

void ImpactTangent::take(const RecordedImpact& impact, const VecX& tau, const Servo* servo) {
  impact_ = &impact;
  implicit_ = impact.map != ImpactMap::kCtec && impact.fallback == Fallback::kNone;
  take_rows(impact);
  margin_ = 1.0;
  if (rows_ > 1) take_friction(impact);
  // Impulses of several contacts at one instant, or with rigid supports, are not those of one contact.
  const VecX off = impact.p_minus + W_ * lambda_ - impact.p_plus;
  if (off.cwiseAbs().maxCoeff() > kSameImpulse * (impact.p_minus.cwiseAbs().maxCoeff() + off.cwiseAbs().maxCoeff()))
    throw NoDerivative({"simultaneous", impact.guard, impact.time}, "Several contacts share one impact",
                       "one contact at a time", "impulses of several contacts that depend on each other",
                       "Start elsewhere; give the persistent contacts some restitution");
  if (implicit_) take_rest(impact, tau, servo);
}

// The rows of the contact at the impact, as the run had them.
void ImpactTangent::take_rows(const RecordedImpact& impact) {
  const auto refuse = [&](const char* fact, const char* reason, const char* expected, const std::string& got,
                          const char* remedy) {
    throw NoDerivative({reason, impact.guard, impact.time}, fact, expected, got, remedy);
  };
  if (impact.points > 1)
    refuse("An impact has several points at once", "witness", "one point that hits first",
           std::to_string(impact.points) + " points", "Start a little tilted, so that one point hits first");
  if (!sequence_.collect_given(impact.q, impact.p_minus, {impact.guard}, Guards::kTouching))
    throw Error("a recorded impact has no contact");
  ClosedGuard& closed = sequence_.closed(0);
  const ContactPoint& point = closed.points[0];
  const bool own = point.kind != PointKind::kWitness && point.kind != PointKind::kLimit;
  if (!contact_.take(impact.q, impact.guard, closed.contacts[0], own ? &point : nullptr))
    refuse("The gap has no second derivative at an impact", "witness", "one pair of nearest points", contact_.why(),
           "Start elsewhere, or round the edges of the shapes");
  rows_ = closed.rows;
  t1_ = closed.t1[0];
  W_ = closed.W.leftCols(rows_);
  Z_ = closed.MinvW.leftCols(rows_);
  W_normal_ = W_.col(0);
  if (!integrator_.node_velocity(impact.q, impact.p_minus, u_)) throw Error("the mass matrix is not positive definite");
  G_.noalias() = W_.transpose() * Z_;
  gamma_.noalias() = W_.transpose() * u_;
  lambda_ = VecX::Constant(1, impact.impulse);
  approach_ = check_closing(impact, gamma_[0], W_normal_.cwiseAbs().dot(u_.cwiseAbs()));
}

ImpactTangent::Mode ImpactTangent::mode_of(const VecX& lambda, const VecX& gamma, double lower, double mu) {
  const double normal = lambda[0], size = std::max(std::abs(normal), std::abs(first_[0]));
  if (lambda.isZero(0) && lower == 0.0) return Mode::kOpen;
  const double friction = lambda.tail<2>().norm(), limit = mu * normal;
  const double speed = gamma.tail<2>().norm() / (gamma_.cwiseAbs().maxCoeff() + 1e-300);
  const bool slips = friction >= limit * (1.0 - kOnCone);
  // How far the friction is from its limit where it sticks, and the slip from zero where it slips.
  margin_ = std::min(margin_, slips ? speed : (limit - friction) / (size + 1e-300));
  return slips ? Mode::kSlip : Mode::kStick;
}

// Poisson's two cone problems again, with the active sets of their solutions.
void ImpactTangent::take_friction(const RecordedImpact& impact) {
  if (implicit_)
    throw NoDerivative({"map", impact.guard, impact.time}, "An implicit impact map was corrected beside friction",
                       "impact='ctec' where there is friction", run_->map == ImpactMap::kMhc ? "'mhc'" : "'dtec'",
                       "Use impact='ctec'");
  std::vector<BlockMember> members{{&sequence_.closed(0), impact.restitution}};
  const PoissonResult block = poisson_.solve(members, impact.p_minus);
  if (!block.ok) throw Error("a recorded impact with friction was not solved");
  if (block.restitution < 1.0)
    throw NoDerivative({"restitution", impact.guard, impact.time},
                       "The restitution of an impact with friction was lowered, because it would have gained energy",
                       "an impact that loses energy", std::to_string(block.restitution) + " of the restitution",
                       "Use a smaller restitution");
  first_ = block.first;
  second_ = block.lambda - block.first;
  lambda_ = block.lambda;
  const double mu = impact.friction;
  const VecX compressed = gamma_ + G_ * first_;
  compression_ = mode_of(first_, compressed, 0.0, mu);
  expansion_ = mode_of(second_, block.gamma_plus, impact.restitution * first_[0], mu);
  if (margin_ < kOnCone)
    throw NoDerivative({"friction", impact.guard, impact.time}, "An impact changes between sticking and slipping",
                       "friction inside of its cone, or slip", "the limit of friction without slip", "Start elsewhere");
}

// The rest of the step, over which an implicit map has its equation.
void ImpactTangent::take_rest(const RecordedImpact& impact, const VecX& tau, const Servo* servo) {
  if (impact.map == ImpactMap::kMhc && run_->stages == 1)
    throw NoDerivative({"map", impact.guard, impact.time},
                       "MHC at order 2 conserves an energy whose derivative is not known",
                       "order 4 or more, or another map", "order 2", "Use order=4, or impact='ctec'");
  integrator_.set_time(impact.time);
  integrator_.set_servo(servo);
  integrator_.forget();
  if (!integrator_.solve_closely(impact.q, impact.p_plus, impact.after, tau))
    throw Error("the rest of a recorded step was not solved");
  integrator_.finish(q1_, p1_);
  rest_.take(impact.q, impact.p_plus, impact.after, tau, impact.time, servo, integrator_.velocities());
  if (!integrator_.node_velocity(q1_, p1_, v1_)) throw Error("the mass matrix is not positive definite");
  if (impact.map == ImpactMap::kMhc) energy_gradient(integrator_, q1_, v1_, force1_);
  const VecX none = VecX::Zero(scene_->tree.nv);
  scalar_slope_ = rest_change(none, W_normal_, 0.0);
  // The node of the impact again, for what follows.
  integrator_.place_node(impact.q);
}

// The derivative of the map's scalar after the impact.
double ImpactTangent::rest_change(const VecX& dq, const VecX& dp, double dh) {
  StepDirection direction;
  direction.q = dq;
  direction.p = dp;
  direction.h = dh;
  if (!rest_.solve(direction, dq1_, dp1_)) throw Error("the derivative of a step was not solved");
  if (impact_->map == ImpactMap::kDtec) return rest_.energy_change();
  return v1_.dot(dp1_) + force1_.dot(dq1_);
}

// dW, dgamma and dG.
void ImpactTangent::add_row_changes(const ImpactDirection& d) {
  const int n = scene_->tree.nv;
  dW_.resize(n, rows_);
  contact_.change(d.q, t1_, dW_);
  const VecX none = VecX::Zero(n);
  rest_.momentum(impact_->q, u_, d.q, none, work_);
  if (d.parameters != nullptr) rest_.add_momentum(impact_->q, u_, *d.parameters, work_);
  dgamma_ = dW_.transpose() * u_ + Z_.transpose() * (d.p - work_);
  dG_ = dW_.transpose() * Z_ + Z_.transpose() * dW_;
  for (int k = 0; k < rows_; ++k) {
    rest_.momentum(impact_->q, Z_.col(k), d.q, none, work_);
    if (d.parameters != nullptr) rest_.add_momentum(impact_->q, Z_.col(k), *d.parameters, work_);
    dG_.col(k) -= Z_.transpose() * work_;
  }
}

// dLambda of one of the two problems: gamma = gamma_0 + G Lambda, dgamma0 = d(gamma_0) + dG Lambda.
VecX ImpactTangent::phase(Mode mode, const VecX& lambda, const VecX& gamma, const VecX& dgamma0, double dlower,
                          double lower, double mu, double dmu) const {
  VecX result = VecX::Zero(3);
  if (mode == Mode::kOpen) return result;
  Mat3 A = Mat3::Zero();
  Vec3 right = Vec3::Zero();
  const bool at_lower = lower > 0.0 && lambda[0] <= lower * (1.0 + kOnCone);
  if (at_lower) {
    A(0, 0) = 1.0;
    right[0] = dlower;
  } else {
    A.row(0) = G_.row(0);
    right[0] = -dgamma0[0];
  }
  if (mode == Mode::kStick) {
    A.bottomRows<2>() = G_.bottomRows<2>();
    right.tail<2>() = -dgamma0.tail<2>();
  } else {
    // Lambda_t + mu Lambda_n s / |s| = 0, s the slip.
    const Eigen::Vector2d s = gamma.tail<2>();
    const double length = s.norm();
    const Eigen::Vector2d direction = s / length;
    const Eigen::Matrix2d turn =
        mu * lambda[0] / length * (Eigen::Matrix2d::Identity() - direction * direction.transpose());
    A.bottomRows<2>() = turn * G_.bottomRows<2>();
    A.bottomRightCorner<2, 2>() += Eigen::Matrix2d::Identity();
    A.bottomLeftCorner<2, 1>() += mu * direction;
    right.tail<2>() = -dmu * lambda[0] * direction - turn * dgamma0.tail<2>();
  }
  return A.partialPivLu().solve(right);
}

void ImpactTangent::apply_friction(const ImpactDirection& d, VecRef dlambda) const {
  const double mu = impact_->friction, e = impact_->restitution;
  const VecX compressed = gamma_ + G_ * first_, after = gamma_ + G_ * lambda_;
  const VecX dfirst = phase(compression_, first_, compressed, dgamma_ + dG_ * first_, 0.0, 0.0, mu, d.mu);
  const VecX start = dgamma_ + dG_ * lambda_ + G_ * dfirst;
  dlambda = dfirst + phase(expansion_, second_, after, start, d.e * first_[0] + e * dfirst[0], e * first_[0], mu, d.mu);
}

// dLambda of the explicit laws from dgamma and dG.
void ImpactTangent::apply_law(const ImpactDirection& d, VecRef dlambda) const {
  if (rows_ > 1) {
    apply_friction(d, dlambda);
    return;
  }
  dlambda[0] = -(d.e * gamma_[0] + (1.0 + impact_->restitution) * dgamma_[0] + lambda_[0] * dG_(0, 0)) / G_(0, 0);
}

void ImpactTangent::apply(const ImpactDirection& d, VecRef dp, double& loss) {
  add_row_changes(d);
  VecX dlambda(rows_);
  const double e = impact_->restitution, gamma = gamma_[0], G = G_(0, 0);
  loss = 0.0;
  if (rows_ == 1)
    loss = -d.e * e * gamma * gamma / G +
           0.5 * (1.0 - e * e) * (2.0 * gamma * dgamma_[0] - gamma * gamma * dG_(0, 0) / G) / G;
  if (implicit_) {
    const VecX start = d.p + lambda_[0] * dW_.col(0);
    dlambda[0] = (d.reference - loss - rest_change(d.q, start, d.rest)) / scalar_slope_;
  } else {
    apply_law(d, dlambda);
  }
  dp = d.p + dW_ * lambda_ + W_ * dlambda;
}

// A change of M changes gamma by -Z^T dM u, and G by -Z^T dM Z.
void ImpactTangent::add_parameters(const VecX& lp, StepAdjoint& adjoint, StepParameters& sums) {
  if (implicit_) return;
  const VecX l = W_.transpose() * lp;
  const ImpactDirection none;
  VecX of_gamma(rows_), dlambda(rows_);
  MatX of_G(rows_, rows_);
  dgamma_ = VecX::Zero(rows_);
  dG_ = MatX::Zero(rows_, rows_);
  const auto gradient = [&](double& entry) {
    entry = 1.0;
    apply_law(none, dlambda);
    entry = 0.0;
    return l.dot(dlambda);
  };
  for (int i = 0; i < rows_; ++i) {
    of_gamma[i] = gradient(dgamma_[i]);
    for (int k = 0; k < rows_; ++k) of_G(i, k) = gradient(dG_(i, k));
  }
  adjoint.add_momentum_parameters(impact_->q, u_, -(Z_ * of_gamma), sums);
  for (int k = 0; k < rows_; ++k) adjoint.add_momentum_parameters(impact_->q, Z_.col(k), -(Z_ * of_G.col(k)), sums);
}

}  // namespace contactvi

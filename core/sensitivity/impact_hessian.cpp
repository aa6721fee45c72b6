#include "sensitivity/impact_hessian.hpp"

namespace contactvi {

ImpactHessian::ImpactHessian(const Scene& scene, const RecordedRun& run)
    : integrator_(scene.tree, run.stages, run.tol, 200), gap_(scene), mass_(scene.tree, run.stages) {}

void ImpactHessian::take(const RecordedImpact& impact, const ImpactTangent& first, const VecX& dq, const VecX& dp) {
  const auto refuse = [&](const char* fact, const char* expected, const std::string& got) {
    throw NoDerivative({"second", impact.guard, impact.time}, fact, expected, got, "Use method='gauss-newton'");
  };
  if (!gap_.take(impact.q, impact.guard, first.contact(0), first.gradient(0)))
    refuse("The gap has no third derivative that is known",
           "a point or a ball at a point, a ball or a face; or a joint limit", gap_.why());
  impact_ = &impact;
  dq_ = dq;
  const Eigen::Index n = dq.size();
  gap_.along(dq, DualX::Zero(n), W_, of_q_);
  VecX u(n);
  if (!integrator_.node_velocity(impact.q, impact.p_minus, u)) throw Error("the mass matrix is not positive definite");
  mass_.take(impact.q, u, dq, dp, integrator_);
  u_ = dual(u, mass_.velocity_change());
  VecX z = value(W_);
  integrator_.solve_mass(z);
  VecX dz = derivative(W_) - mass_.momentum_change(z);
  integrator_.solve_mass(dz);
  z_ = dual(z, dz);
  gamma_ = W_.dot(u_);
  G_ = W_.dot(z_);
}

void ImpactHessian::apply(MovingGradient& l) {
  const DualNumber more = 1.0 + impact_->restitution, lambda = -more * gamma_ / G_;
  const DualX bar = dual(l.v, l.dv);
  const DualNumber along = bar.dot(W_), c = -more * along / G_, d = -lambda * along / G_;
  const DualX y = lambda * bar + c * u_ + (2.0 * d) * z_, x = c * u_ + d * z_, after = bar + c * z_;
  DualX W(y.size());
  gap_.along(dq_, y, W, of_q_);
  const MovingGradient mass = mass_.momentum(value(x), derivative(x), value(z_), derivative(z_));
  l.q += value(of_q_) - mass.q;
  l.dq += derivative(of_q_) - mass.dq;
  l.v = value(after);
  l.dv = derivative(after);
}

}  // namespace contactvi

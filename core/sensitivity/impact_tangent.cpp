#include "sensitivity/impact_tangent.hpp"

#include <algorithm>
#include <cmath>

#include "base/differences.hpp"
#include "model/coupling.hpp"
#include "sensitivity/kinks.hpp"
#include "step/energy.hpp"

namespace contactvi {

namespace {
// Of the momenta: to which a recorded impact is the one that is differentiated.
constexpr double kSameImpulse = 1e-7;

ImpactOptions options_of(const RecordedRun& run) {
  ImpactOptions options;
  options.map = run.map;
  options.record_contacts = false;
  return options;
}
}  // namespace

ImpactTangent::ImpactTangent(const Scene& scene, const RecordedRun& run, Kinks& kinks)
    : scene_(&scene),
      run_(&run),
      kinks_(&kinks),
      integrator_(scene.tree, run.stages, run.tol, 200),
      guards_(scene, run.contact_points),
      sequence_(scene, integrator_, guards_, options_of(run)),
      projection_(scene.tree),
      rest_(scene.tree, run.stages),
      u_(scene.tree.nv),
      work_(scene.tree.nv),
      q1_(scene.tree.nq),
      p1_(scene.tree.nv),
      v1_(scene.tree.nv),
      force1_(scene.tree.nv),
      dq1_(scene.tree.nv),
      dp1_(scene.tree.nv) {}

void ImpactTangent::refuse(const char* reason, int guard, const char* fact, const char* expected,
                           const std::string& got, const char* remedy) const {
  throw NoDerivative({reason, guard, impact_->time}, fact, expected, got, remedy);
}

void ImpactTangent::meet(const char* reason, int guard, const char* fact, const char* expected, const std::string& got,
                         const char* remedy) const {
  kinks_->meet(NoDerivative({reason, guard, impact_->time}, fact, expected, got, remedy));
}

void ImpactTangent::take(const RecordedImpact& impact, const VecX& p_plus, const VecX& tau, const Servo* servo) {
  impact_ = &impact;
  implicit_ = impact.map != ImpactMap::kCtec && impact.fallback == Fallback::kNone;
  take_rows(impact);
  margin_ = 1.0;
  other_law_ = nullptr;
  if (rows_ > 1) take_poisson(impact);
  // What several contacts did one after the other, or with rigid supports, is not what these did.
  VecX off = impact.p_minus + W_ * lambda_ - p_plus;
  fold_momentum(scene_->tree, off);
  if (off.cwiseAbs().maxCoeff() > kSameImpulse * (impact.p_minus.cwiseAbs().maxCoeff() + off.cwiseAbs().maxCoeff()))
    refuse("simultaneous", impact.guard, "Several contacts share one impact", "impulses that follow from their law",
           "other impulses", "Start elsewhere; give the persistent contacts some restitution");
  if (implicit_) take_rest(impact, tau, servo);
}

int ImpactTangent::find(const ContactPoint& point) const {
  for (int i = 0; i < points(); ++i)
    if (same_point(contact_of(i), point)) return i;
  return -1;
}

// Closes the contacts of the impact, as they were.
void ImpactTangent::collect(const RecordedImpact& impact) {
  if (impact.block != nullptr) {
    if (!sequence_.collect_block(impact.q, impact.p_minus, *impact.block))
      throw Error("the mass matrix is not positive definite");
    return;
  }
  if (impact.points > 1)
    refuse("witness", impact.guard, "An impact has several points at once", "one point that hits first",
           std::to_string(impact.points) + " points", "Start a little tilted, so that one point hits first");
  if (!sequence_.collect_given(impact.q, impact.p_minus, impact.time, {impact.guard}, Guards::kTouching))
    throw Error("a recorded impact has no contact");
}

// The rows of the points of the impact, as the run had them.
void ImpactTangent::take_rows(const RecordedImpact& impact) {
  collect(impact);
  points_.clear();
  contact_points_.clear();
  t1_.clear();
  surfaces_.clear();
  rows_ = 0;
  // Without a block one point had the impact: the first one of the contact.
  for (int k = 0; k < sequence_.count(); ++k) {
    const ClosedGuard& closed = sequence_.closed(k);
    const int count = impact.block != nullptr ? closed.count : 1;
    for (int i = 0; i < count; ++i) {
      const ContactPoint& point = closed.points[i];
      const bool own = point.kind != PointKind::kWitness && point.kind != PointKind::kLimit;
      const std::size_t number = points_.size();
      if (contacts_.size() <= number) contacts_.emplace_back(*scene_);
      if (!contacts_[number].take(impact.q, closed.guard, closed.contacts[i], own ? &point : nullptr))
        refuse("witness", closed.guard, "The gap has no second derivative at an impact", "one pair of nearest points",
               contacts_[number].why(), "Start elsewhere, or round the edges of the shapes");
      const double e = impact.block != nullptr ? closed.e : impact.restitution;
      points_.push_back({rows_, closed.rows_per_point(), e, closed.friction(i, impact.p_minus)});
      contact_points_.push_back(point);
      contact_points_.back().guard = closed.guard;
      t1_.push_back(closed.t1[i]);
      surfaces_.emplace_back();
      if (closed.mu > 0.0) surfaces_.back().take(*scene_, closed.guard, contacts_[number], closed.t1[i], impact.time);
      rows_ += closed.rows_per_point();
    }
  }
  W_.resize(scene_->tree.nv, rows_);
  Z_.resize(scene_->tree.nv, rows_);
  offset_.resize(rows_);
  mu_fixed_.resize(scene_->tree.elements.constraint_rows, rows_);
  int at = 0;
  for (int k = 0; k < sequence_.count(); ++k) {
    const ClosedGuard& closed = sequence_.closed(k);
    const int rows = impact.block != nullptr ? closed.rows : closed.rows_per_point();
    W_.middleCols(at, rows) = closed.W.leftCols(rows);
    Z_.middleCols(at, rows) = closed.MinvW.leftCols(rows);
    offset_.segment(at, rows) = closed.offset.head(rows);
    mu_fixed_.middleCols(at, rows) = closed.mu_fixed.leftCols(rows);
    at += rows;
  }
  if (!integrator_.node_velocity(impact.q, impact.p_minus, u_)) throw Error("the mass matrix is not positive definite");
  gradients_ = W_;
  if (projection_.any()) {
    projection_.take(integrator_, impact.q, impact.time);
    gradients_ = projection_.take_rows(mu_fixed_, W_, Z_);
  }
  G_.noalias() = W_.transpose() * Z_;
  gamma_ = W_.transpose() * u_ + offset_;
  lambda_ = VecX::Constant(1, impact.impulse);
  approach_ = 1.0;
  if (points() == 1) approach_ = check_closing(impact, gamma_[0], gradients_.col(0).cwiseAbs().dot(u_.cwiseAbs()));
}

// Poisson's two cone problems again, with the active sets of their solutions.
void ImpactTangent::take_poisson(const RecordedImpact& impact) {
  if (implicit_)
    refuse("map", impact.guard, "An implicit impact map was corrected beside friction",
           "impact='ctec' where there is friction", run_->map == ImpactMap::kMhc ? "'mhc'" : "'dtec'",
           "Use impact='ctec'");
  std::vector<BlockMember> members;
  for (int k = 0; k < (impact.block != nullptr ? sequence_.count() : 1); ++k)
    members.push_back({&sequence_.closed(k), impact.block != nullptr ? sequence_.closed(k).e : impact.restitution});
  const bool elastic = members.front().e > 0.0;
  const ContactLaw* law = members.size() == 1 || elastic ? scene_->law(members.front().closed->guard) : nullptr;
  const ImpactBlockResult solved = impact_block_.solve(members, impact.p_minus, law);
  if (!solved.ok) throw Error("a recorded impact with friction was not solved");
  if (solved.restitution < 1.0)
    refuse("restitution", impact.guard,
           "The restitution of an impact with friction was lowered, because it would have gained energy",
           "an impact that loses energy", std::to_string(solved.restitution) + " of the restitution",
           "Use a smaller restitution");
  lambda_ = solved.lambda;
  if (law != nullptr && law->is_other()) {
    other_law_ = law;
    course_ = impact_block_.course();
    return;
  }
  law_.take(points_, gamma_, G_, solved.first, solved.lambda);
  margin_ = law_.margin();
  if (margin_ < kOnCone)
    meet("friction", impact.guard, "An impact changes between sticking and slipping",
         "friction inside of its cone, or slip", "the limit of friction without slip", "Start elsewhere");
  if (!law_.determines(Z_))
    meet("redundant", impact.guard, "An impact depends on how contact points share its impulse",
         "impulses that the laws of contact determine", "points whose friction can be shared in several ways",
         "Use fewer points (contact_points=3), or less friction");
}

// The rest of the step, over which an implicit map has its equation.
void ImpactTangent::take_rest(const RecordedImpact& impact, const VecX& tau, const Servo* servo) {
  const bool constrained = projection_.any();
  if (impact.map == ImpactMap::kMhc && (run_->stages == 1 || constrained))
    throw NoDerivative(
        {"map", impact.guard, impact.time}, "MHC at order 2 conserves an energy whose derivative is not known",
        constrained ? "another map with constraints, whose steps are of order 2" : "order 4 or more, or another map",
        constrained ? "'mhc' with constraints" : "order 2",
        constrained ? "Use impact='dtec' or 'ctec'" : "Use order=4, or impact='ctec'");
  const VecX none = VecX::Zero(scene_->tree.nv), along = W_.col(0);
  if (constrained) {
    take_constrained_rest(impact, tau, servo);
    scalar_slope_ = rest_change(none, along, 0.0, 0.0) + offset_[0];
    return;
  }
  integrator_.set_time(impact.time);
  integrator_.set_servo(servo);
  integrator_.forget();
  if (!integrator_.solve_closely(impact.q, impact.p_plus, impact.after, tau))
    throw Error("the rest of a recorded step was not solved");
  integrator_.finish(q1_, p1_);
  rest_.take(impact.q, impact.p_plus, impact.after, tau, impact.time, servo, integrator_.velocities());
  if (!integrator_.node_velocity(q1_, p1_, v1_)) throw Error("the mass matrix is not positive definite");
  if (impact.map == ImpactMap::kMhc) energy_gradient(integrator_, q1_, v1_, force1_);
  scalar_slope_ = rest_change(none, along, 0.0, 0.0);
  // The node of the impact again, for what follows.
  integrator_.place_node(impact.q);
}

void ImpactTangent::take_constrained_rest(const RecordedImpact& impact, const VecX& tau, const Servo* servo) {
  if (!constrained_rest_)
    constrained_rest_.reset(
        new ConstrainedRest{{*scene_, guards_, guards_.manifolds()}, {}, ContactStepTangent(*scene_, *kinks_)});
  auto& [step, record, tangent] = *constrained_rest_;
  step.restart();
  step.invalidate();
  step.set_nominal(run_->dt);
  step.set_time(impact.time);
  step.set_servo(servo);
  if (!step.solve_closely(impact.q, impact.p_plus, impact.after, tau))
    throw Error("the rest of a recorded step was not solved");
  record = step.record();
  tangent.take(record, tau, servo);
}

// The derivative of the map's scalar after the impact. dt: of the time of the impact.
double ImpactTangent::rest_change(const VecX& dq, const VecX& dp, double dh, double dt) {
  if (projection_.any()) {
    ContactStepDirection direction;
    direction.q = dq;
    direction.p = dp;
    direction.h = dh;
    direction.t = dt;
    constrained_rest_->tangent.solve(direction, dq1_, dp1_);
    return constrained_rest_->tangent.energy_change_after();
  }
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
  std::vector<VecX> moved(points_.size());
  for (int i = 0; i < points(); ++i) {
    contacts_[i].change(d.q, t1_[i], dW_.middleCols(points_[i].row, points_[i].rows));
    if (surfaces_[i].moves()) moved[i] = surfaces_[i].change(contacts_[i]) + d.time * surfaces_[i].rate();
  }
  const VecX none = VecX::Zero(n);
  rest_.momentum(impact_->q, u_, d.q, none, work_);
  if (d.parameters != nullptr) rest_.add_momentum(impact_->q, u_, *d.parameters, work_);
  const VecX heavier = work_;
  turned_.resize(n, rows_);
  for (int k = 0; k < rows_; ++k) {
    rest_.momentum(impact_->q, Z_.col(k), d.q, none, work_);
    if (d.parameters != nullptr) rest_.add_momentum(impact_->q, Z_.col(k), *d.parameters, work_);
    turned_.col(k) = work_;
  }
  doffset_.setZero(rows_);
  if (projection_.any()) projection_.change(d.q, d.time, turned_, dW_, doffset_);
  for (int i = 0; i < points(); ++i)
    if (surfaces_[i].moves()) doffset_.segment(points_[i].row + 1, moved[i].size()) += moved[i];
  dgamma_ = dW_.transpose() * u_ + Z_.transpose() * (d.p - heavier) + doffset_;
  dG_ = dW_.transpose() * Z_ + Z_.transpose() * dW_ - Z_.transpose() * turned_;
}

// Changes of the coefficients of restitution, with those by the speeds before the impact and by its time.
VecX ImpactTangent::restitution_changes(const ImpactDirection& d) const {
  VecX de = d.e;
  for (int i = 0; i < points(); ++i) {
    const ContactLaw* law = scene_->law(guard(i));
    if (law == nullptr || !restitution_varies(*law) || !(points_[i].e > 0.0)) continue;
    int first = points_[i].row;  // of the points of the contact the one that closes fastest
    for (int k = 0; k < points(); ++k)
      if (guard(k) == guard(i) && gamma_[points_[k].row] < gamma_[first]) first = points_[k].row;
    Eigen::Vector2d slip = Eigen::Vector2d::Zero(), dslip = slip;
    if (points_[i].rows > 1) {
      slip = gamma_.segment<2>(first + 1).cwiseQuotient(law->shares);
      dslip = dgamma_.segment<2>(first + 1).cwiseQuotient(law->shares);
    }
    const double speed = slip.norm();
    const Vec3 slopes = restitution_slopes(*law, -gamma_[first], speed, impact_->time);
    de[i] += slopes[2] * d.time - slopes[0] * dgamma_[first];
    if (speed > 0.0) de[i] += slopes[1] * slip.dot(dslip) / speed;
  }
  return de;
}

// Changes of the coefficients of friction, with those by the slip before the impact.
VecX ImpactTangent::friction_changes(const ImpactDirection& d) const {
  VecX dmu = d.mu;
  for (int i = 0; i < points(); ++i) {
    const ContactLaw* law = scene_->law(guard(i));
    if (law == nullptr || !(law->mu.given() || law->mu_of_state != nullptr) || points_[i].rows == 1) continue;
    const Eigen::Vector2d slip = gamma_.segment<2>(points_[i].row + 1);
    const double speed = slip.norm();
    dmu[i] = 0.0;
    double slope = 0.0;
    if (law->mu_of_state != nullptr) {
      const FrictionState found = impact_friction(*law, speed, impact_->time, true);
      dmu[i] = found.by_time * d.time;
      slope = found.by_slip;
    } else if (speed > 0.0) {
      slope = law->mu.slope(speed);
    }
    if (speed > 0.0) dmu[i] += slope * slip.normalized().dot(dgamma_.segment<2>(points_[i].row + 1));
  }
  return dmu;
}

// dLambda of a law without a closed form of its derivative: by differences of its solution, a function of few numbers.
void ImpactTangent::apply_other_law(const ImpactDirection& d, const VecX& de, VecX& dlambda) {
  constexpr double kStep = 1e-3;  // of the numbers
  dlambda.setZero(rows_);
  const VecX dmu = friction_changes(d);
  VecX mu(points());
  for (int i = 0; i < points(); ++i) mu[i] = points_[i].mu;
  const double share =
      std::max({dgamma_.cwiseAbs().maxCoeff() / gamma_.cwiseAbs().maxCoeff(),
                dG_.cwiseAbs().maxCoeff() / G_.cwiseAbs().maxCoeff(), std::abs(de[0]), dmu.cwiseAbs().maxCoeff()});
  if (!(share > 0.0)) return;
  const double step = kStep / share;
  for (const DifferenceTerm& term : kDifference) {
    const double by = term.count * step;
    const ImpactBlockResult& there = impact_block_.solve_again(gamma_ + by * dgamma_, G_ + by * dG_,
                                                               points_[0].e + by * de[0], mu + by * dmu, other_law_);
    if (!there.ok) throw Error("a recorded impact was not solved");
    if (d.checked && impact_block_.course() != course_)
      meet("friction", impact_->guard, "An impact is next to a change of what it does",
           "friction inside of its cone, or slip", "one that sticks, slips or turns back beside this one",
           "Start elsewhere");
    dlambda += term.weight / (kDifferenceParts * step) * there.lambda;
  }
}

// dLambda of the explicit laws from dgamma and dG.
void ImpactTangent::apply_law(const ImpactDirection& d, VecX& dlambda) {
  const VecX de = restitution_changes(d);
  if (rows_ == 1) {
    const double restitution = de[0] * gamma_[0] + (1.0 + impact_->restitution) * dgamma_[0];
    dlambda = VecX::Constant(1, -(restitution + lambda_[0] * dG_(0, 0)) / G_(0, 0));
    return;
  }
  if (other_law_ != nullptr) return apply_other_law(d, de, dlambda);
  const double size = std::max(d.size_p, d.p.size() > 0 ? d.p.cwiseAbs().maxCoeff() : 0.0);
  const PoissonDirection direction{dgamma_, dG_, de, friction_changes(d),
                                   size * Z_.cwiseAbs().colwise().sum().transpose()};
  const PoissonTangent::Outcome outcome = law_.solve(direction, dlambda);
  if (outcome == PoissonTangent::Outcome::kSolved || !d.checked) return;
  if (outcome == PoissonTangent::Outcome::kKink)
    meet("simultaneous", impact_->guard, "A contact neither closes nor separates in an impact of others",
         "contacts that take part in an impact, or separate", "one on the border between both",
         "Start elsewhere; on_kink='taken' lets it take no part");
  else
    meet("redundant", impact_->guard, "Contact points that share their load contradict each other along a direction",
         "a direction that keeps the points of a face closed together", "one that opens some of them",
         "Start with the bodies apart, or in touch at one point; on_kink='taken' keeps them closed");
}

void ImpactTangent::apply(const ImpactDirection& d, VecRef dp, double& loss) {
  add_row_changes(d);
  VecX dlambda(rows_);
  const double e = impact_->restitution, gamma = gamma_[0], G = G_(0, 0);
  loss = 0.0;
  if (rows_ == 1)
    loss = -restitution_changes(d)[0] * e * gamma * gamma / G +
           0.5 * (1.0 - e * e) * (2.0 * gamma * dgamma_[0] - gamma * gamma * dG_(0, 0) / G) / G;
  if (implicit_) {
    const VecX start = d.p + lambda_[0] * dW_.col(0);
    const double driven = lambda_[0] * doffset_[0];
    dlambda[0] = (d.reference - loss - driven - rest_change(d.q, start, d.rest, d.time)) / scalar_slope_;
    loss += driven + dlambda[0] * offset_[0];
  } else {
    apply_law(d, dlambda);
  }
  dp = d.p + dW_ * lambda_ + W_ * dlambda;
}

// A change of M changes gamma by -Z^T dM u, and G by -Z^T dM Z; with constraints also the rows.
void ImpactTangent::add_parameters(const VecX& lp, StepAdjoint& adjoint, StepParameters& sums) {
  if (implicit_) return;
  const VecX l = W_.transpose() * lp;
  ImpactDirection none;
  none.checked = false;
  none.e = none.mu = VecX::Zero(points());
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
  MatX of_turned = -Z_ * of_G;
  if (projection_.any()) {
    const MatX of_W = lp * lambda_.transpose() + u_ * of_gamma.transpose() + Z_ * (of_G + of_G.transpose());
    of_turned += projection_.mass_gradient(of_W, of_gamma);
  }
  for (int k = 0; k < rows_; ++k) adjoint.add_momentum_parameters(impact_->q, Z_.col(k), of_turned.col(k), sums);
}

}  // namespace contactvi

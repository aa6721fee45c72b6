#include "sensitivity/end_force.hpp"

#include <algorithm>
#include <cmath>

#include "base/differences.hpp"
#include "base/tolerances.hpp"
#include "model/coordinates.hpp"
#include "model/force_rate.hpp"
#include "step/energy.hpp"

namespace contactvi {

namespace {
// Of the configuration [m; rad] and of the speeds: so short that the nearest points stay on their features. The
// rounding of the differences is 1e-11 of the terms of the force; a feature that is nearer is as good as a kink.
constexpr double kForceStep = 1e-5;
constexpr double kZero =
    1e-5;  // of the terms of the forces: that of the contact that is released, as the run located it
constexpr double kUnique = 1e-9;  // of a force: what the laws leave open
// Of the rate of the force: to which it has to be known from differences in the time of prescribed motions and of
// forces, which are made over four of these lengths [s] and over two.
constexpr double kSameRate = 1e-7, kLongest = 2e-4;
}  // namespace

EndForce::EndForce(const Scene& scene, const RecordedRun& run)
    : scene_(&scene),
      t0_(run.t0),
      masses_(scene.tree, 1, 1e-12, 1),
      guards_(scene, run.contact_points),
      tangent_(scene),
      constraints_(scene.tree),
      parameters_(scene.tree),
      v_(scene.tree.nv),
      a_(scene.tree.nv) {}

void EndForce::refuse(const std::string& got) const {
  const auto contacts = static_cast<int>(end_.contacts.size());
  const int guard = end_.ended < contacts ? end_.contacts[static_cast<std::size_t>(end_.ended)].before.point.guard : -1;
  throw NoDerivative({end_.releases ? "release" : "stick", guard, end_.time},
                     "The time at which a phase of contact ends has no derivative that is known",
                     "a force that falls to zero beside contacts that stay loaded", got, "Start elsewhere");
}

PhaseEnd release_of(const ContactStepRecord& s) {
  PhaseEnd end{s.t + s.h, s.q1, s.p1, s.v1, static_cast<int>(s.lambda.size()), {}, {}, s.ended, true};
  for (const ContactStepRecord::Joint& joint : s.joints) end.joints.push_back({joint.dof, joint.limit});
  for (const ContactStepRecord::Contact& c : s.contacts)
    end.contacts.push_back({c.before, c.t1_end, c.end.normal, c.outcome.slips, c.row, c.outcome.rolls});
  return end;
}

void EndForce::take(PhaseEnd end, const VecX& tau, const Servo* servo) {
  end_ = std::move(end);
  time_ = end_.time;
  tau_ = &tau;
  masses_.set_time(end_.time);
  masses_.set_servo(servo);
  mu_.resize(static_cast<Eigen::Index>(end_.contacts.size()));
  for (std::size_t i = 0; i < end_.contacts.size(); ++i) mu_[static_cast<Eigen::Index>(i)] = end_.contacts[i].before.mu;
  any_adhesion_ = false;
  for (const PhaseEnd::Contact& c : end_.contacts) any_adhesion_ |= adhesion(*scene_, c.before, end_.time) > 0.0;
  loaded_.assign(end_.contacts.size(), 1);
  const double left = settle_loads();
  if (!(std::abs(left) <= kZero * size_)) refuse("a force of " + std::to_string(left) + " N");
  for (std::size_t i = 0; i < end_.contacts.size(); ++i) {
    const int r = end_.contacts[i].row;
    const bool clear = loaded_[i] != 0 ? forces_[r] > kZero * size_ : accelerations_[r] > kZero * size_ * A_(r, r);
    if (static_cast<int>(i) != end_.ended && !clear) refuse("another contact on the border of its load");
  }
  VecX acceleration = W_ * forces_;
  masses_.solve_mass(acceleration);
  acceleration += a_;
  parameters_.take(end_.q, v_, acceleration, servo);
}

// The force. Contacts that are about to be released besides carry no load: the one that pulls most is taken out, until
// none does.
double EndForce::settle_loads() {
  const PhaseEnd& s = end_;
  for (;;) {
    const double left = force(s.q, s.p, *tau_, mu_);
    int worst = -1;
    for (std::size_t i = 0; i < s.contacts.size(); ++i) {
      if (static_cast<int>(i) == s.ended || loaded_[i] == 0 || !(forces_[s.contacts[i].row] < 0.0)) continue;
      if (worst < 0 || forces_[s.contacts[i].row] < forces_[s.contacts[worst].row]) worst = static_cast<int>(i);
    }
    if (worst < 0) return left;
    loaded_[worst] = 0;
  }
}

double EndForce::force(const VecX& q, const VecX& p, const VecX& tau, const VecX& mu) {
  const PhaseEnd& s = end_;
  const int rows = s.rows, equations = constraints_.rows();
  if (!masses_.node_velocity(q, p, v_)) throw Error("the mass matrix is not positive definite");
  forward_dynamics(masses_, q, v_, time_, tau, a_);
  guards_.place(q);
  W_.setZero(scene_->tree.nv, rows);
  dW_.setZero(scene_->tree.nv, rows);
  if (equations > 0) {
    constraints_.take(q, time_);
    W_.leftCols(equations) = constraints_.gradients();
    constraints_.change(v_, 1.0, dW_.leftCols(equations));
  }
  for (std::size_t k = 0; k < s.joints.size(); ++k) W_(s.joints[k].dof, equations + static_cast<int>(k)) = 1.0;
  std::vector<Vec3> t1(s.contacts.size(), Vec3::Zero()), normals = t1;
  std::vector<Loaded> states;
  VecX own = VecX::Zero(rows), own_rates = own, pulls = own;
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const ContactPoint& point = s.contacts[i].before.point;
    const int count = s.contacts[i].before.rows();
    Contact contact;
    if (point.kind == PointKind::kWitness || point.kind == PointKind::kLimit) {
      guards_.evaluate_witness(point.guard, contact);
    } else {
      guards_.manifolds().evaluate(point, guards_.placements(), contact);
    }
    normals[i] = contact.normal;
    if (count > 1)
      t1[i] = guards_.has_axis(point.guard) ? guards_.tangent(point.guard, contact.normal)
                                            : carried_tangent(s.contacts[i].t1, s.contacts[i].normal, contact.normal);
    guards_.rows(point.guard, contact, t1[i], W_.middleCols(s.contacts[i].row, count));
    if (!tangent_.take(q, point.guard, contact, &point)) refuse(tangent_.why());
    const int r = s.contacts[i].row;
    tangent_.change(v_, t1[i], dW_.middleCols(r, count));
    pulls[r] = adhesion(*scene_, s.contacts[i].before, time_);
    if (count == 1 || !guards_.moves(point.guard)) continue;
    surface_.take(*scene_, point.guard, tangent_, t1[i], time_);
    own.segment(r + 1, count - 1) = surface_.velocity();
    own_rates.segment(r + 1, count - 1) = surface_.change(tangent_) + surface_.rate();
  }
  if (any_adhesion_) {
    VecX pulled = W_ * pulls;
    masses_.solve_mass(pulled);
    a_ -= pulled;
  }
  MatX MinvW = W_;
  masses_.solve_masses(MinvW);
  VecX c = W_.transpose() * a_ + dW_.transpose() * v_ + own_rates;
  if (equations > 0) c.head(equations) += constraints_.rate_change(v_, 1.0);
  A_.noalias() = W_.transpose() * MinvW;
  accelerations_ = c;
  MatX A = A_;
  size_ = 0.0;
  for (const PhaseEnd::Contact& contact : s.contacts) {
    const int r = contact.row;
    const double terms = W_.col(r).cwiseAbs().dot(a_.cwiseAbs()) + dW_.col(r).cwiseAbs().dot(v_.cwiseAbs());
    size_ = std::max(size_, terms / A(r, r) + pulls[r]);
  }
  for (const PhaseEnd::Joint& joint : s.joints) size_ = std::max(size_, joint.limit);
  const double still = kStill * (1.0 + s.v.cwiseAbs().maxCoeff());
  for (std::size_t k = 0; k < s.joints.size(); ++k) {
    const double speed = s.v[s.joints[k].dof];
    if (std::abs(speed) <= still) continue;
    const int r = equations + static_cast<int>(k);
    A.row(r).setZero();
    A(r, r) = 1.0;
    c[r] = std::copysign(s.joints[k].limit, speed);
  }
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const int r = s.contacts[i].row, count = s.contacts[i].before.rows();
    if (loaded_[i] == 0) {
      A.middleRows(r, count).setZero();
      A.block(r, r, count, count).setIdentity();
      c.segment(r, count).setZero();
      continue;
    }
    // What sticks up to its release begins to slip before it: its friction goes to zero with the normal force.
    const bool ends = s.releases && static_cast<int>(i) == s.ended;
    const int guard = s.contacts[i].before.point.guard;
    const bool varies = scene_->law(guard) != nullptr && scene_->law(guard)->mu.given();
    const bool by_state = scene_->friction_by_state(guard);
    double speed = 0.0;
    for (const auto& [row, size, rolls] : friction_rows(r, count)) {
      const bool slips = rolls ? s.contacts[i].rolls : s.contacts[i].slips;
      if (!(slips || ends)) continue;
      A.middleRows(row, size).setZero();
      A.block(row, row, size, size).setIdentity();
      c.segment(row, size).setZero();
      if (!slips) continue;
      const VecX w = W_.middleCols(row, size).transpose() * v_ + own.segment(row, size);
      const double bound = rolls ? 1.0 : varies ? scene_->sliding_friction(guard, w.norm()) : mu[i];
      A.block(row, r, size, 1) = bound * w.normalized();
      speed = w.norm();
    }
    if (by_state)
      states.push_back({i, {guard, !s.contacts[i].slips, speed, s.contacts[i].before.force[0], time_, mu[i]}});
  }
  VecX coefficients = mu;
  FrictionRounds rounds;
  do {
    for (const auto& [i, state] : states) {
      const int r = s.contacts[i].row;
      if (s.contacts[i].slips) A.block(r + 1, r, 2, 1) *= state.mu / coefficients[static_cast<Eigen::Index>(i)];
      coefficients[static_cast<Eigen::Index>(i)] = state.mu;
    }
    system_.compute(A, equations);
    const VecX size = c.cwiseAbs() + A.cwiseAbs().rowwise().sum();
    if (!system_.solve(c, size, forces_)) refuse("contacts that contradict each other");
  } while (!states.empty() && rounds.go_on(follow_forces(states)));
  if (!rounds.settled()) refuse("friction that is not found with its normal force");
  accelerations_.noalias() += A_ * forces_;
  measured_ = forces_;
  for (const auto& [i, state] : states)
    if (!s.releases && !s.contacts[i].slips) measured_[s.contacts[i].row] *= state.mu;
  set_weights(t1, normals, coefficients);
  if (system_.free().cols() > 0 && (weights_.transpose() * system_.free()).norm() > kUnique)
    refuse("points that share their load");
  const auto contacts = static_cast<int>(s.contacts.size());
  const double limit = s.ended < contacts ? 0.0 : s.joints[static_cast<std::size_t>(s.ended - contacts)].limit;
  return limit + weights_.dot(measured_);
}

// By how much of themselves coefficients of friction change with the forces that were found with them.
double EndForce::follow_forces(std::vector<Loaded>& states) const {
  double change = 0.0;
  for (auto& [i, state] : states) {
    state.normal = forces_[end_.contacts[i].row];
    change = FrictionRounds::larger(change, friction_of(*scene_, state), state.mu);
  }
  return change;
}

// Of the friction of points that share a load only the sum of those of a pair is known.
void EndForce::set_weights(const std::vector<Vec3>& t1, const std::vector<Vec3>& normals, const VecX& mu) {
  const PhaseEnd& s = end_;
  weights_.setZero(s.rows);
  const auto contacts = static_cast<int>(s.contacts.size());
  if (s.ended >= contacts) {
    const int r = constraints_.rows() + s.ended - contacts;
    weights_[r] = -std::copysign(1.0, forces_[r]);
    return;
  }
  const auto ended = static_cast<std::size_t>(s.ended);
  if (s.releases) {
    weights_[s.contacts[ended].row] = 1.0;
    return;
  }
  std::vector<std::size_t> together;
  Vec3 friction = Vec3::Zero();
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const PhaseEnd::Contact& c = s.contacts[i];
    const bool shares = system_.free().cols() > 0 && c.before.point.guard == s.contacts[ended].before.point.guard;
    if (i != ended && !(shares && !c.slips && c.before.mu > 0.0 && loaded_[i] != 0)) continue;
    together.push_back(i);
    friction += forces_[c.row + 1] * t1[i] + forces_[c.row + 2] * normals[i].cross(t1[i]);
  }
  const Vec3 along = friction.normalized();
  for (const std::size_t i : together) {
    const int r = s.contacts[i].row;
    weights_[r] = scene_->friction_by_state(s.contacts[i].before.point.guard) ? 1.0 : mu[s.ended];
    weights_[r + 1] = -along.dot(t1[i]);
    weights_[r + 2] = -along.dot(normals[i].cross(t1[i]));
  }
}

double EndForce::change(const VecX& dq, const VecX& dp, const VecX& dtau, const VecX& dmu) {
  const PhaseEnd& s = end_;
  const int n = scene_->tree.nv;
  if (!masses_.node_velocity(s.q, s.p, v_)) throw Error("the mass matrix is not positive definite");
  VecX dv = dp;
  masses_.solve_mass(dv);
  const double speed = 1.0 + v_.cwiseAbs().maxCoeff(),
               input = 1.0 + (tau_->size() > 0 ? tau_->cwiseAbs().maxCoeff() : 0.0);
  double size = std::max(dq.cwiseAbs().maxCoeff(), dv.cwiseAbs().maxCoeff() / speed);
  if (dtau.size() > 0) size = std::max(size, dtau.cwiseAbs().maxCoeff() / input);
  if (dmu.size() > 0) size = std::max(size, dmu.cwiseAbs().maxCoeff());
  if (size == 0.0) return 0.0;
  const double step = kForceStep / size;
  VecX q(scene_->tree.nq);
  double total = 0.0;
  for (const auto& [count, weight] : kDifference) {
    const double by = count * step;
    integrate(scene_->tree, s.q, dq, by, q);
    VecX tau = *tau_;
    if (dtau.size() > 0) tau = (tau.size() > 0 ? tau : VecX(VecX::Zero(n))) + by * dtau;
    const VecX mu = dmu.size() > 0 ? VecX(mu_ + by * dmu) : mu_;
    total += weight * force(q, s.p + by * dp, tau, mu);
  }
  return total / (kDifferenceParts * step);
}

double EndForce::change(const StepParameters& parameters) {
  VecX dp, dtau;
  parameters_.change(parameters, dp, dtau);
  engine_to_public(scene_->tree, end_.q, dtau);
  return change(VecX::Zero(dp.size()), dp, dtau, VecX());
}

void EndForce::add_parameters(const VecX& lp, const VecX& ltau, StepParameters& sums) {
  VecX lforce = ltau;
  public_to_engine(scene_->tree, end_.q, lforce);
  parameters_.add_gradient(lp, lforce, sums);
}

double EndForce::rate(const VecX& fq, const VecX& fp) {
  const double rest = change(fq, fp, VecX(), VecX());
  const Elements& e = scene_->tree.elements;
  return e.driven() || forces_depend_on_time(e) || scene_->contacts_depend_on_time() ? rest + rate_in_time(rest) : rest;
}

// Of the force at one state, where prescribed motions and forces that depend on time alone go on: from the forces,
// which are smooth where their norm, as that of friction, is not.
double EndForce::rate_in_time(double rest) {
  const double step = std::min(kLongest, 0.25 * (end_.time - t0_));
  double found[2];
  for (int k = 0; k < 2; ++k) {
    const double length = k == 0 ? step : 0.5 * step;
    VecX rates = VecX::Zero(end_.rows);
    for (int i = 4; i >= 0; --i) {
      time_ = end_.time - i * length;
      force(end_.q, end_.p, *tau_, mu_);
      rates += kOneSided[i] / (kDifferenceParts * length) * measured_;
    }
    found[k] = weights_.dot(rates);
  }
  time_ = end_.time;
  if (!(std::abs(found[1] - found[0]) <= kSameRate * std::abs(rest + found[1])))
    refuse("a prescribed motion or a force in time that is not smooth, or not known well enough");
  return found[1];
}

}  // namespace contactvi

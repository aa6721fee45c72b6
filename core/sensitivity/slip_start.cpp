#include "sensitivity/slip_start.hpp"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>

#include "base/differences.hpp"
#include "model/coordinates.hpp"
#include "model/force_rate.hpp"
#include "step/energy.hpp"

namespace contactvi {

namespace {
// Of the configuration [m; rad], of the speeds, of the inputs and coefficients of friction; of angles [rad]; at most,
// of time [s].
constexpr double kStep = 1e-5, kTurn = 1e-3, kTime = 2e-4;
// Of the mobility along the normal: less than that across a slip is none; and of the largest pivot.
constexpr double kPlane = 1e-12, kDependentSlips = 1e-7;
}  // namespace

SlipStart::SlipStart(const Scene& scene)
    : scene_(&scene),
      masses_(scene.tree, 1, 1e-12, 1),
      node_(scene),
      parameters_(scene.tree),
      v_(scene.tree.nv),
      a_(scene.tree.nv) {}

bool SlipStart::take(const HeldStepRecord& step, PersistentRows& phase, std::vector<int> begins, const VecX& tau,
                     const Servo* servo) {
  record_ = &step;
  phase_ = &phase;
  begins_ = std::move(begins);
  if (begins_.empty()) return true;
  const Tree& tree = scene_->tree;
  const Eigen::Index n = tree.nv;
  const auto slides = static_cast<Eigen::Index>(phase.slides().size());
  masses_.set_time(step.t);
  masses_.set_servo(servo);
  start_ = {step.q0, step.p0, tau.size() > 0 ? tau : VecX(VecX::Zero(n)), VecX(slides), step.angles.col(0), step.t};
  rows_of_slides_.resize(static_cast<std::size_t>(slides));
  for (std::size_t i = 0; i < step.contacts.size(); ++i) {
    const int j = phase.slide(i);
    if (j < 0) continue;
    start_.mu[j] =
        phase.friction(i, std::abs(step.slips(j, 0)), step.contacts[i].force[0], step.t, step.contacts[i].mu, false).mu;
    rows_of_slides_[static_cast<std::size_t>(j)] = tree.elements.constraint_rows + phase.row(i);
  }
  known_ = true;
  across(start_);
  turn_ = node_.frame_turns(step.contacts, phase);
  parameters_.take(step.q0, v_, a_, servo);
  MatX mobility(n, n);
  mobility.setIdentity();
  masses_.solve_masses(mobility);
  const double speed = 1.0 + v_.cwiseAbs().maxCoeff(), input = 1.0 + start_.tau.cwiseAbs().maxCoeff();
  const auto sized = [](double step_size) { return [=](Eigen::Index) { return step_size; }; };
  by_q_ = differences(n, sized(kStep), [&](Place& at, Eigen::Index k, double by) {
    integrate(tree, step.q0, VecX::Unit(n, k), by, at.q);
  });
  by_p_ = differences(
      n, [&](Eigen::Index k) { return kStep * speed / mobility.col(k).cwiseAbs().maxCoeff(); },
      [](Place& at, Eigen::Index k, double by) { at.p[k] += by; });
  by_tau_ = differences(n, sized(kStep * input), [](Place& at, Eigen::Index k, double by) { at.tau[k] += by; });
  by_mu_ = differences(slides, sized(kStep), [](Place& at, Eigen::Index k, double by) { at.mu[k] += by; });
  by_t_ = MatX::Zero(static_cast<Eigen::Index>(begins_.size()), 1);
  if (tree.elements.driven() || forces_depend_on_time(tree.elements) || scene_->contacts_depend_on_time())
    set_time_rates(step.h);
  by_others_ = differences(slides, sized(kTurn), [](Place& at, Eigen::Index k, double by) { at.angles[k] += by; });
  solve_turns(mobility);
  return known_;
}

// Of the accelerations of the slips that begin, by `count` numbers.
template <class Size, class Move>
MatX SlipStart::differences(Eigen::Index count, Size size, Move move) {
  MatX found = MatX::Zero(static_cast<Eigen::Index>(begins_.size()), count);
  for (Eigen::Index k = 0; k < count; ++k) {
    const double step = size(k);
    for (const auto& [steps, weight] : kDifference) {
      Place at = start_;
      move(at, k, steps * step);
      found.col(k) += (weight / (kDifferenceParts * step)) * across(at)(begins_);
    }
  }
  return found;
}

// Of time, within the step: functions of users may have no values before the start of the run or after its end.
void SlipStart::set_time_rates(double step_length) {
  const double length = std::min(kTime, 0.25 * step_length);
  for (int i = 0; i < 5; ++i) {
    Place at = start_;
    at.t += i * length;
    by_t_.col(0) -= kOneSided[i] / (kDifferenceParts * length) * across(at)(begins_);
  }
}

// The accelerations of the slips across their directions. Leaves the velocity and the acceleration in v_ and a_.
VecX SlipStart::across(const Place& at) {
  const Eigen::Index n = scene_->tree.nv, slides = at.angles.size();
  if (!masses_.node_velocity(at.q, at.p, v_)) throw Error("the mass matrix is not positive definite");
  forward_dynamics(masses_, at.q, v_, at.t, at.tau, a_);
  const Eigen::Index rows = record_->lambda.rows();
  if (!node_.take(at.q, at.t, VecX::Zero(n), {VecX::Zero(rows), 0.0, at.angles, at.mu, VecX()}, *record_, *phase_, 0)) {
    known_ = false;
    return VecX::Zero(slides);
  }
  VecX loaded = node_.load();
  masses_.solve_mass(loaded);
  a_ += loaded;
  MatX watched, along;
  node_.change_speeds(v_, watched, along);
  VecX c = node_.watched().transpose() * a_ + watched * v_, f, mu = at.mu;
  c += node_.speed_rates(v_);
  MatX forces, E;
  FrictionRounds rounds;
  do {
    forces = node_.gradients();
    for (Eigen::Index j = 0; j < slides; ++j)
      forces.col(rows_of_slides_[static_cast<std::size_t>(j)]) -= mu[j] * node_.along().col(j);
    masses_.solve_masses(forces);
    E = node_.watched().transpose() * forces;
    system_.compute(E.topRows(rows), scene_->tree.elements.constraint_rows);
    system_.solve(c.head(rows), VecX::Zero(rows), f);
  } while (phase_->friction_by_forces() && rounds.go_on(follow_forces(at, f, mu)));
  known_ = known_ && rounds.settled();
  a_ += forces * f;
  return c.tail(slides) + E.bottomRows(slides) * f;
}

// By how much of themselves coefficients of friction change with the forces f that were found with them.
double SlipStart::follow_forces(const Place& at, const VecX& f, VecX& mu) const {
  double change = 0.0;
  const VecX slips = node_.slips(v_);
  for (std::size_t i = 0; i < record_->contacts.size(); ++i) {
    const int j = phase_->slide(i);
    if (j < 0 || !phase_->friction_by_state(i)) continue;
    const double force = f[rows_of_slides_[static_cast<std::size_t>(j)]];
    const double found = phase_->friction(i, std::abs(slips[j]), force, at.t, mu[j], false).mu;
    change = FrictionRounds::larger(change, found, mu[j]);
  }
  return change;
}

// From the derivatives of the accelerations to those of the directions for which they are zero. What cannot move
// across its direction keeps it.
void SlipStart::solve_turns(const MatX& mobility) {
  across(start_);
  const auto count = static_cast<Eigen::Index>(begins_.size());
  MatX own = by_others_(Eigen::all, begins_);
  for (Eigen::Index k = 0; k < count; ++k) {
    const int j = begins_[static_cast<std::size_t>(k)];
    const VecX side = node_.watched().col(record_->lambda.rows() + j),
               normal = node_.gradients().col(rows_of_slides_[static_cast<std::size_t>(j)]);
    if (side.dot(mobility * side) > kPlane * normal.dot(mobility * normal)) continue;
    own.row(k).setZero();
    own.col(k).setZero();
  }
  Eigen::CompleteOrthogonalDecomposition<MatX> factor;
  factor.setThreshold(kDependentSlips);
  factor.compute(own);
  by_others_(Eigen::all, begins_).setZero();
  for (MatX* by : {&by_q_, &by_p_, &by_tau_, &by_mu_, &by_t_, &by_others_}) *by = MatX(-factor.solve(*by));
}

void SlipStart::add_turns(const ContactStepDirection& d, const VecX& dmu, VecX& turns) {
  if (begins_.empty()) return;
  const Eigen::Index n = by_q_.cols();
  const VecX dq = d.q.size() > 0 ? d.q : VecX(VecX::Zero(n));
  VecX dp = d.p.size() > 0 ? d.p : VecX(VecX::Zero(n)), dtau = d.tau.size() > 0 ? d.tau : VecX(VecX::Zero(n));
  if (d.parameters != nullptr) {
    VecX own_p, own_tau;
    parameters_.change(*d.parameters, own_p, own_tau);
    engine_to_public(scene_->tree, record_->q0, own_tau);
    dp += own_p;
    dtau += own_tau;
  }
  const VecX framed = turn_ * dq;
  const VecX found =
      by_q_ * dq + by_p_ * dp + by_tau_ * dtau + by_mu_ * dmu + by_t_.col(0) * d.t + by_others_ * (turns - framed);
  turns(begins_) = found + framed(begins_);
}

void SlipStart::pass(VecX& lturns, VecX& lmu, StepParameters& sums) {
  if (begins_.empty()) return;
  const VecX l = lturns(begins_);
  lturns(begins_).setZero();
  lturns += by_others_.transpose() * l;
  if (lmu.size() > 0) lmu += by_mu_.transpose() * l;
  VecX lforce = by_tau_.transpose() * l;
  public_to_engine(scene_->tree, record_->q0, lforce);
  parameters_.add_gradient(by_p_.transpose() * l, lforce, sums);
}

}  // namespace contactvi

#include "step/integrator.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace contactvi {

namespace {
constexpr double kRefactor = 3e-3;                   // change between sweeps above which the factor is made again
constexpr double kRounding = 2e-13, kFloor = 1e-11;  // errors at which no more progress may be rounding, after a while
constexpr double kProgress = 0.7;                    // per sweep
constexpr int kIdle = 8;                             // sweeps without progress: these start values lead nowhere
constexpr double kFarTurn = 3.5;                     // rad per step of a ball, where its chart is still good
constexpr double kClose = 1e-15;  // tolerance where an event or an impact hangs on the step: to rounding
constexpr double kBest = 1e-2;    // contraction
// Contraction from which on the Newton matrix pays, and stages up to which it does: measured on chains of 10 to 100
// links and the Allegro hand, it saves sweeps with 4 stages and more too, but not time (benchmarks/README.md).
constexpr double kSlow = 0.3;
constexpr int kNewtonStages = 3;
constexpr double kNear = 0.3, kFarEnergy = 30.0;
constexpr double kVerySlow = 0.5;  // contraction from which on acceleration pays
}  // namespace

Integrator::Integrator(const Tree& tree, int stages, double tol, int max_iterations)
    : tree_(&tree),
      tol_(tol),
      max_iterations_(max_iterations),
      model_(tree),
      stages_(tree, model_, stages),
      node_(tree, model_, 1),
      stiff_(tree, stages_),
      start_(tree.nv, stages_),
      acceleration_(tree.nv, stages_),
      placements_(tree),
      q0_(tree.nq),
      p0_(tree.nv),
      q_ramp_(tree.nq),
      p_ramp_(tree.nv),
      q_ramp1_(tree.nq),
      p_ramp1_(tree.nv),
      v0_(tree.nv),
      q_stage_(tree.nq),
      carry_q_(VecX::Zero(tree.nq)),
      carry_p_(VecX::Zero(tree.nv)),
      next_carry_q_(VecX::Zero(tree.nq)),
      next_carry_p_(VecX::Zero(tree.nv)),
      rates_(tree.nv, stages),
      velocities_(tree.nv, stages) {}

// after: the step begins so much later than time().
void Integrator::begin(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau, double after) {
  if (q0.data() != q0_.data()) q0_ = q0;
  if (p0.data() != p0_.data()) p0_ = p0;
  h_ = h;
  stages_.set_time(time_ + after);
  stages_.begin(q0_, p0_, h, tau);
}

double Integrator::relative_error() const {
  double worst = 0.0;
  for (int i = 0; i < stages_.count(); ++i) {
    const double error = std::abs(stages_.error(i));
    const double scale = std::max({std::abs(stages_.kinetic(i)), stages_.floor(i), error});
    const double relative = error > 0.0 ? error / scale : error;
    if (std::isnan(relative)) return relative;
    worst = std::max(worst, relative);
  }
  return std::sqrt(worst);
}

// Largest energy of a stage: of its motion, or of the kick that the single forces give it.
double Integrator::energy() const {
  double largest = 0.0;
  for (int i = 0; i < stages_.count(); ++i)
    largest = std::max({largest, std::abs(stages_.kinetic(i)), stages_.floor(i)});
  return largest;
}

// Whether a sweep that left this error, theta times the one before, was the last that the step needs.
bool Integrator::converged(double error, double theta, bool accelerated) const {
  if (error <= tol_) return true;
  // One ratio alone may flatter: no contraction better than kBest is believed, hardly any after an acceleration.
  const double believed = std::max(theta, accelerated ? 0.5 : kBest);
  return theta >= 0.0 && theta < 1.0 && error * believed / (1.0 - believed) <= tol_;
}

bool Integrator::iterate() {
  solved_ = false;
  double previous = -1.0, theta = -1.0, best = std::numeric_limits<double>::infinity();
  int idle = 0;  // sweeps without progress
  bool newton = newton_, accelerated = false;
  acceleration_.clear();
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical) continue;
    double* X = stages_.X() + static_cast<std::size_t>(joint.iv) * stages_.padded();
    std::fill(X, X + 3 * stages_.padded(), 0.0);
  }
  bool factor = true;
  for (int k = 0; k < max_iterations_; ++k) {
    stages_.sweep((factor ? kLaneFactor : 0) | (k == 0 ? kLaneFirst : 0) | (newton ? kLaneNewton : 0));
    if (stiff_.any()) {
      if (factor) stiff_.factor(stages_, q0_);
      stiff_.correct(stages_);
    }
    ++counters.stage_iterations;
    ++stage_iterations_;
    counters.factorizations += factor;
    const double error = relative_error();
    if (!std::isfinite(error)) {
      why_ = "a number is not finite";
      newton_ = false;
      return false;
    }
    theta = previous > 0.0 ? error / previous : -1.0;
    residual_ = error;
    if (k == 0) energy_scale_ = energy();
    // Long steps have solutions far from the motion too; whoever gets there has lost the way.
    if (energy() > kFarEnergy * energy_scale_) break;
    if (converged(error, theta, accelerated)) {
      newton_ = newton;
      return solved_ = true;
    }
    idle = error < kProgress * best ? 0 : idle + 1;
    best = std::min(best, error);
    // Far down, sweeps that gain nothing any more have met rounding; further up they lead nowhere.
    if ((idle >= 2 && error < kRounding) || (idle >= 4 && error < kFloor && !accelerated)) return solved_ = true;
    if (idle >= (accelerated ? 2 * kIdle : kIdle)) break;
    const bool slow = k >= 2 && theta > kSlow, turn = slow && !newton && stages_.count() <= kNewtonStages;
    if (factor && accelerated) acceleration_.clear();  // its residuals belong to another matrix
    newton = newton || turn;
    factor = turn || (error > kRefactor && !accelerated);
    if ((slow && theta > kVerySlow && !turn && error < kNear) || accelerated) {
      acceleration_.apply(stages_);
      accelerated = true;
    }
    previous = error;
  }
  why_ = "the sweeps do not converge";
  return false;
}

bool Integrator::turns_too_far() {
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical) continue;
    double turn2 = 0.0;
    for (int d = 0; d < 3; ++d) {
      const double X = stages_.sum(stages_.rate(), joint.iv + d);
      turn2 += X * X;
    }
    if (turn2 <= kFarTurn * kFarTurn) continue;
    why_ = "a body turns more than half a revolution in one step";
    return true;
  }
  return false;
}

void Integrator::start_constant(const VecCRef& v0) {
  const int S = stages_.padded();
  for (int d = 0; d < tree_->nv; ++d) std::fill_n(stages_.v() + static_cast<std::size_t>(d) * S, S, v0[d]);
}

bool Integrator::solve_closely(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) {
  const double tol = tol_;
  tol_ = std::min(tol_, kClose);
  const bool solved = solve(q0, p0, h, tau);
  tol_ = tol;
  return solved;
}

bool Integrator::solve(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) {
  // The same step again from another momentum, as impact maps ask for: its velocities are the best start.
  const bool again = start_.count() == 0 && solved_ && h == h_ && (q0.array() == q0_.array()).all();
  begin(q0, p0, h, tau);
  part_ = false;
  stage_iterations_ = 0;
  why_ = "";
  const int s = stages_.count();
  if (again && iterate()) return !turns_too_far();
  if (start_.count() > 0) {
    start_.extrapolate(h, stages_);
    if (iterate()) return !turns_too_far();
    ++counters.retries;
    if (s > 2) {
      start_.extrapolate_smoothed(h, stages_);
      if (iterate()) return !turns_too_far();
    }
  }
  if (!node_velocity(q0_, p0_, v0_)) {
    why_ = "the mass matrix is not positive definite";
    return false;
  }
  start_constant(v0_);
  if (iterate()) return !turns_too_far();
  return start_by_ramp(tau) && !turns_too_far();
}

// Small steps first, each from the polynomial of the one before; together they give start values for the whole.
bool Integrator::start_by_ramp(const VecX& tau) {
  const double whole = h_, parts[4] = {0.125, 0.125, 0.25, 0.5};
  const VecX q0 = q0_, p0 = p0_;  // a slow way anyway
  start_.clear_pieces();
  start_.forget();
  q_ramp_ = q0;
  p_ramp_ = p0;
  double done = 0.0;
  for (int k = 0; k < 4; ++k) {
    const double h = parts[k] * whole;
    begin(q_ramp_, p_ramp_, h, tau, done);
    if (k == 0) {
      start_constant(v0_);
    } else {
      start_.extrapolate(h, stages_);
    }
    if (!iterate()) {
      start_.forget();  // what there is leads away from here
      return false;
    }
    start_.add_piece(stages_, done, h);
    start_.push(stages_, h);
    finish(q_ramp1_, p_ramp1_);
    q_ramp_ = q_ramp1_;
    p_ramp_ = p_ramp1_;
    done += h;
  }
  start_.forget();
  begin(q0, p0, whole, tau);
  start_.assemble(whole, stages_);
  return iterate();
}

bool Integrator::solve_part(const StepPath& path, double alpha, const VecCRef& q0, const VecCRef& p0, const VecX& tau) {
  const GaussTable& table = stages_.table();
  const int s = stages_.count(), S = stages_.padded();
  begin(q0, p0, alpha * path.h(), tau);
  part_ = true;
  stage_iterations_ = 0;
  why_ = "";
  for (int i = 0; i < s; ++i) {
    path.velocity(alpha * table.c[i], v0_);
    for (int d = 0; d < tree_->nv; ++d) stages_.v()[d * S + i] = v0_[d];
  }
  for (int i = s; i < S; ++i)
    for (int d = 0; d < tree_->nv; ++d) stages_.v()[d * S + i] = v0_[d];
  const double tol = tol_;
  tol_ = std::min(tol_, kClose);
  const bool solved = iterate() || (node_velocity(q0_, p0_, v0_) && (start_constant(v0_), iterate()));
  tol_ = tol;
  return solved && !turns_too_far();
}

void Integrator::finish(VecRef q1, VecRef p1) {
  if (model_.lanes.balls > 0) stages_.rates();
  const double carried = part_ ? 0.0 : 1.0;  // what is carried is that of the next whole step by then
  for (const Joint& joint : tree_->joints) {
    const int iq = joint.iq, iv = joint.iv;
    if (joint.type == JointType::kSpherical) {
      const Vec3 X1(stages_.sum(stages_.rate(), iv), stages_.sum(stages_.rate(), iv + 1),
                    stages_.sum(stages_.rate(), iv + 2));
      const Quat start(q0_[iq + 3], q0_[iq], q0_[iq + 1], q0_[iq + 2]);
      const Vec3 end = stages_.ball_end(joint, p0_);
      q1.segment<4>(iq) = (start * so3_exp(X1)).normalized().coeffs();
      p1.segment<3>(iv) = end;
      continue;
    }
    for (int d = 0; d < joint.nv; ++d) {
      const double position_impulse = stages_.sum(stages_.G(), iv + d) + carried * carry_p_[iv + d],
                   p = p0_[iv + d] + position_impulse;
      next_carry_p_[iv + d] = position_impulse - (p - p0_[iv + d]);
      p1[iv + d] = p;
    }
    if (joint.type == JointType::kContinuous) {
      const double angle = stages_.sum(stages_.v(), iv), c = std::cos(angle), s = std::sin(angle);
      const double c1 = q0_[iq] * c - q0_[iq + 1] * s, s1 = q0_[iq] * s + q0_[iq + 1] * c;
      const double scale = 1 / std::sqrt(c1 * c1 + s1 * s1);
      q1[iq] = scale * c1;
      q1[iq + 1] = scale * s1;
      continue;
    }
    for (int d = 0; d < joint.nv; ++d) {
      const double way = stages_.sum(stages_.v(), iv + d) + carried * carry_q_[iq + d], q = q0_[iq + d] + way;
      next_carry_q_[iq + d] = way - (q - q0_[iq + d]);
      q1[iq + d] = q;
    }
  }
}

void Integrator::accept() {
  ++counters.steps;
  carry_q_ = next_carry_q_;
  carry_p_ = next_carry_p_;
  start_.push(stages_, h_);
}

void Integrator::forget() {
  carry_q_.setZero();
  carry_p_.setZero();
  start_.forget();
}

Integrator::Memory Integrator::memory() {
  solved_ = false;  // the stages are not remembered
  const double* P = stages_.P();
  return {start_, carry_q_, carry_p_, std::vector<double>(P, P + tree_->nv * stages_.padded()), newton_};
}

void Integrator::recall(const Memory& memory) {
  start_ = memory.start;
  carry_q_ = memory.carry_q;
  carry_p_ = memory.carry_p;
  std::copy(memory.momenta.begin(), memory.momenta.end(), stages_.P());
  newton_ = memory.newton;
  solved_ = false;
}

const MatX& Integrator::rates() {
  if (model_.lanes.balls > 0) stages_.rates();
  for (int i = 0; i < stages_.count(); ++i)
    for (int d = 0; d < tree_->nv; ++d) rates_(d, i) = stages_.rate()[d * stages_.padded() + i];
  return rates_;
}

const MatX& Integrator::velocities() {
  for (int i = 0; i < stages_.count(); ++i)
    for (int d = 0; d < tree_->nv; ++d) velocities_(d, i) = stages_.v()[d * stages_.padded() + i];
  return velocities_;
}

bool Integrator::node_velocity(const VecCRef& q, const VecCRef& p, VecRef v) {
  node_.at(q);
  node_.place();
  node_.factor();
  for (int d = 0; d < tree_->nv; ++d) node_.dv()[d] = p[d];
  node_.solve();
  double energy = 0.0;
  for (int d = 0; d < tree_->nv; ++d) {
    v[d] = node_.dv()[d];
    energy += v[d] * p[d];
  }
  return energy >= 0.0;  // false for NaN
}

void Integrator::solve_mass(VecRef x) {
  for (int d = 0; d < tree_->nv; ++d) node_.dv()[d] = x[d];
  node_.solve();
  for (int d = 0; d < tree_->nv; ++d) x[d] = node_.dv()[d];
}

void Integrator::dynamics(const VecCRef& q, const VecCRef& v, VecRef P, VecRef G) {
  node_.at(q);
  for (int d = 0; d < tree_->nv; ++d) node_.v()[d] = v[d];
  node_.evaluate();
  for (int d = 0; d < tree_->nv; ++d) {
    P[d] = node_.P()[d];
    G[d] = node_.G()[d];
  }
}

}  // namespace contactvi

#include "step/integrator.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace contactvi {

namespace {
constexpr double kRefactor = 3e-3;  // relative error above which the factor is made again
// Errors below which iterations without progress have met rounding: after two of them, and after four.
constexpr double kStagnantSoon = 2e-13, kStagnantLate = 1e-11;
constexpr double kProgress = 0.7;          // ratio of errors that counts as progress of an iteration
constexpr int kMostStagnant = 8;           // iterations without progress after which the start values are given up
constexpr double kFarTurn = 3.5;           // [rad] turn of a spherical joint in one step up to which its chart is good
constexpr double kCloseTolerance = 1e-15;  // relative error of steps on which an event or an impact depends: rounding
constexpr double kBestContraction = 1e-2;  // no better contraction is believed
// Contraction from which on the Newton matrix pays, and stages up to which it does: measured on chains of 10 to 100
// links and the Allegro hand, it saves iterations with 4 stages and more too, but not time (benchmarks/README.md).
constexpr double kSlow = 0.3;
constexpr int kNewtonStages = 3;
constexpr double kVerySlow = 0.5;           // contraction from which on acceleration pays,
constexpr double kAccelerationError = 0.3;  // where the error is below this
constexpr double kFarEnergy = 30.0;         // growth of the energy over a solve: the solution found is not the motion
}  // namespace

Integrator::Integrator(const Tree& tree, int stages, double tol, int max_iterations)
    : StepEquations(tree, stages),
      tol_(tol),
      max_iterations_(max_iterations),
      start_(tree.nv, stages_),
      acceleration_(tree.nv, stages_),
      v0_(tree.nv) {}

double Integrator::relative_error() const {
  double worst = 0.0;
  for (int i = 0; i < stages_.count(); ++i) {
    const double error = std::abs(stages_.error(i));
    const double scale = std::max({std::abs(stages_.kinetic(i)), stages_.impulse_energy(i), error});
    const double relative = error > 0.0 ? error / scale : error;
    if (std::isnan(relative)) return relative;
    worst = std::max(worst, relative);
  }
  return std::sqrt(worst);
}

// Largest energy of a stage: of its motion, or of the impulses that its forces give one by one.
double Integrator::largest_energy() const {
  double largest = 0.0;
  for (int i = 0; i < stages_.count(); ++i)
    largest = std::max({largest, std::abs(stages_.kinetic(i)), stages_.impulse_energy(i)});
  return largest;
}

// Whether the iteration that left this error, theta times the one before, was the last that the step needs.
bool Integrator::converged(double error, double theta, bool accelerated) const {
  if (error <= tol_) return true;
  // One ratio of errors may be too good by chance, and after an acceleration it tells hardly anything.
  const double believed = std::max(theta, accelerated ? 0.5 : kBestContraction);
  return theta >= 0.0 && theta < 1.0 && error * believed / (1.0 - believed) <= tol_;
}

bool Integrator::solve_stages() {
  solved_ = false;
  double previous = -1.0, theta = -1.0, best = std::numeric_limits<double>::infinity(), first_energy = 0.0;
  int stagnant = 0;  // iterations without progress
  bool newton = newton_, accelerated = false;
  acceleration_.clear();
  clear_turns();
  bool factor = true;
  for (int k = 0; k < max_iterations_; ++k) {
    iterate_stages((factor ? kLaneFactor : 0) | (k == 0 ? kLaneFirst : 0) | (newton ? kLaneNewton : 0));
    ++stage_iterations_;
    const double error = relative_error();
    if (!std::isfinite(error)) {
      why_ = "a number is not finite";
      newton_ = false;
      return false;
    }
    theta = previous > 0.0 ? error / previous : -1.0;
    residual_ = error;
    if (k == 0) first_energy = largest_energy();
    // The equations of long steps have solutions far from the motion too: the iterations are on their way to one.
    if (largest_energy() > kFarEnergy * first_energy) break;
    if (converged(error, theta, accelerated)) {
      newton_ = newton;
      return solved_ = true;
    }
    stagnant = error < kProgress * best ? 0 : stagnant + 1;
    best = std::min(best, error);
    // Near the solution, iterations that gain nothing any more have met rounding; further off they lead nowhere.
    if ((stagnant >= 2 && error < kStagnantSoon) || (stagnant >= 4 && error < kStagnantLate && !accelerated))
      return solved_ = true;
    if (stagnant >= (accelerated ? 2 * kMostStagnant : kMostStagnant)) break;
    const bool slow = k >= 2 && theta > kSlow, turn = slow && !newton && stages_.count() <= kNewtonStages;
    if (factor && accelerated) acceleration_.clear();  // its residuals belong to another matrix
    newton = newton || turn;
    factor = turn || (error > kRefactor && !accelerated);
    if ((slow && theta > kVerySlow && !turn && error < kAccelerationError) || accelerated) {
      acceleration_.apply(stages_);
      accelerated = true;
    }
    previous = error;
  }
  why_ = "the stage iterations do not converge";
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

bool Integrator::solve_closely(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) {
  const double tol = tol_;
  tol_ = std::min(tol_, kCloseTolerance);
  const bool solved = solve(q0, p0, h, tau);
  tol_ = tol;
  return solved;
}

bool Integrator::solve(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) {
  // Impact maps solve one step again and again from other momenta: its own velocities are then the best start.
  const bool again = start_.count() == 0 && solved_ && h == h_ && (q0.array() == q0_.array()).all();
  begin(q0, p0, h, tau);
  part_ = false;
  stage_iterations_ = 0;
  why_ = "";
  const int s = stages_.count();
  if (again && solve_stages()) return !turns_too_far();
  if (start_.count() > 0) {
    start_.extrapolate(h, stages_);
    if (solve_stages()) return !turns_too_far();
    if (s > 2) {
      start_.extrapolate_smoothed(h, stages_);
      if (solve_stages()) return !turns_too_far();
    }
  }
  if (!node_velocity(q0_, p0_, v0_)) {
    why_ = "the mass matrix is not positive definite";
    return false;
  }
  start_constant(v0_);
  if (solve_stages()) return !turns_too_far();
  return start_by_ramp(tau) && !turns_too_far();
}

// Small steps first, each from the polynomial of the one before; together they give start values for the whole. This
// is rare and costs much more than the vectors that it allocates.
bool Integrator::start_by_ramp(const VecX& tau) {
  const double whole = h_, parts[4] = {0.125, 0.125, 0.25, 0.5};
  const VecX q0 = q0_, p0 = p0_;
  VecX q = q0, p = p0, q1(tree_->nq), p1(tree_->nv);
  start_.clear_pieces();
  start_.forget();
  double done = 0.0;
  for (int k = 0; k < 4; ++k) {
    const double h = parts[k] * whole;
    begin(q, p, h, tau, done);
    if (k == 0) {
      start_constant(v0_);
    } else {
      start_.extrapolate(h, stages_);
    }
    if (!solve_stages()) {
      start_.forget();  // its polynomials lead to another solution
      return false;
    }
    start_.add_piece(stages_, done, h);
    start_.push(stages_, h);
    finish(q1, p1);
    q = q1;
    p = p1;
    done += h;
  }
  start_.forget();
  begin(q0, p0, whole, tau);
  start_.assemble(whole, stages_);
  return solve_stages();
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
  tol_ = std::min(tol_, kCloseTolerance);
  const bool solved = solve_stages() || (node_velocity(q0_, p0_, v0_) && (start_constant(v0_), solve_stages()));
  tol_ = tol;
  return solved && !turns_too_far();
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

void Integrator::start_anew() {
  forget();
  solved_ = newton_ = false;
  std::fill_n(stages_.P(), tree_->nv * stages_.padded(), 0.0);  // the first iteration measures with them
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

}  // namespace contactvi

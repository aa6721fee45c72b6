#include "step/integrator.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace contactvi {

namespace {
constexpr double kFarTurn = 3.5;           // [rad] turn of a spherical joint in one step up to which its chart is good
constexpr double kCloseTolerance = 1e-15;  // relative error of steps on which an event or an impact depends: rounding
}  // namespace

Integrator::Integrator(const Tree& tree, int stages, double tol, int max_iterations)
    : StepEquations(tree, stages),
      iteration_(tol, max_iterations),
      start_(tree.nv, stages_),
      acceleration_(tree.nv, stages_),
      v0_(tree.nv) {}

bool Integrator::solve_stages() {
  solved_ = false;
  iteration_.begin(newton_);
  acceleration_.clear();
  clear_turns();
  if (lanes_ != nullptr) company_->iterate(*this, *lanes_);
  while (iteration_.goes_on()) {
    iterate_stages(iteration_.flags());
    judge_iteration();
    if (iteration_.accelerates()) accelerate();
  }
  residual_ = iteration_.error();
  if (iteration_.converged()) newton_ = iteration_.newton();
  if (!iteration_.finite()) newton_ = false;
  solved_ = iteration_.solved();
  if (!solved_) why_ = iteration_.finite() ? "the stage iterations do not converge" : "a number is not finite";
  return solved_;
}

void Integrator::judge_iteration() {
  ++stage_iterations_;
  iteration_.judge(stages_);
  if (iteration_.forgets_acceleration()) acceleration_.clear();
}

bool Integrator::turns_too_far() {
  if (model_.lanes.balls == 0) return false;
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
  const double tol = iteration_.tol();
  iteration_.set_tol(std::min(tol, kCloseTolerance));
  const bool solved = solve(q0, p0, h, tau);
  iteration_.set_tol(tol);
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
  const double tol = iteration_.tol();
  iteration_.set_tol(std::min(tol, kCloseTolerance));
  const bool solved = solve_stages() || (node_velocity(q0_, p0_, v0_) && (start_constant(v0_), solve_stages()));
  iteration_.set_tol(tol);
  return solved && !turns_too_far();
}

void Integrator::accept() {
  ++counters.steps;
  carry_q_.swap(next_carry_q_);
  carry_p_.swap(next_carry_p_);
  start_.push(stages_, h_);
}

void Integrator::forget() {
  carry_q_.setZero();
  carry_p_.setZero();
  start_.forget();
}

void Integrator::join(LaneCompany* company) {
  company_ = company;
  // The factor of stiff elements is not the kernel's alone.
  const bool shares = company != nullptr && stages_.count() == 1 && !stiff_.any();
  lanes_ = shares ? &company->lanes_of(*this) : nullptr;
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

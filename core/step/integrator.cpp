#include "step/integrator.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "step/energy.hpp"
#include "step/guide.hpp"

namespace contactvi {

namespace {
constexpr double kCloseTolerance = 1e-15;  // relative error of steps on which an event or an impact depends: rounding

// Whether LaneFlight knows all joints.
bool can_fly(const Tree& tree) {
  return std::all_of(tree.joints.begin(), tree.joints.end(), [](const Joint& joint) {
    return joint.type == JointType::kRevolute || joint.type == JointType::kHelical ||
           joint.type == JointType::kPrismatic || joint.type == JointType::kTranslation ||
           joint.type == JointType::kSpherical;
  });
}
}  // namespace

Integrator::Integrator(const Tree& tree, int stages, double tol, int max_iterations, bool constrained)
    : StepEquations(tree, stages),
      iteration_(tol, max_iterations),
      ahead_(tree.nq, tree.nv, model_.lanes.balls > 0),
      start_(tree.nv, stages_),
      v0_(tree.nv) {
  if (!constrained) return;
  constraints_ = std::make_unique<StageConstraints>(tree, stages);
  q1_.resize(tree.nq);
  p1_.resize(tree.nv);
  hold(nullptr);
}

void Integrator::hold(PhaseRows* rows) {
  if (!constraints_) return;
  constraints_->hold(rows);
  solved_ = false;
  keeps_rows_ = constraints_->any();
  momentum_ = keeps_rows_ ? &constraints_->start_momentum() : &p0_;
  if (!keeps_rows_) stages_.clear_impulse();
}

void Integrator::begin(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau, double after) {
  StepEquations::begin(q0, p0, h, tau, after);
  if (keeps_rows_) constraints_->begin(*this, q0_, p0_, time_ + after, h, tau);
}

// Of a step that is solved: whether it ends as it should.
bool Integrator::ends_well() {
  if (turns_too_far()) return false;
  if (!keeps_rows_) return true;
  StepEquations::finish(q1_, p1_);
  if (constraints_->close(*this, stages_, q1_, p1_)) return true;
  why_ = "the constraints cannot be met";
  return false;
}

bool Integrator::solve_stages() {
  solved_ = false;
  iteration_.begin(newton_, std::exchange(keeps_factor_, false));
  acceleration_.clear();
  clear_turns();
  // What steps of a chosen length start from is good to many digits. The first iterations would only find the turns
  // that belong to it, one or two digits each.
  if (limits_truncation()) stages_.settle_turns(iteration_.tol());
  looks_at_truncation_ = limits_truncation();
  if (lanes_ != nullptr) company_->iterate(*this, *lanes_);
  while (iteration_.goes_on()) {
    const int flags = iteration_.flags();
    if (keeps_rows_) constraints_->place_nodes(stages_);
    iterate_stages(flags);
    if (keeps_rows_) constraints_->correct(*this, stages_, stiff_, (flags & kLaneFactor) != 0);
    judge_iteration();
    if (exceeds_truncation()) return false;
    if (iteration_.accelerates()) accelerate();
  }
  residual_ = iteration_.error();
  if (iteration_.converged()) newton_ = iteration_.newton();
  if (!iteration_.finite()) newton_ = false;
  solved_ = iteration_.solved();
  if (!solved_ && keeps_rows_) constraints_->give_up();
  if (!solved_) why_ = iteration_.finite() ? "the stage iterations do not converge" : "a number is not finite";
  return solved_;
}

// Whether nothing more is to be tried: the step is solved, or it is too long.
bool Integrator::settles() { return solve_stages() || too_long_; }

// Whether the truncation is above the limit, by more than further iterations are expected to change it. Where it is
// below the limit by as much, it is looked at again at the end only.
bool Integrator::exceeds_truncation() {
  const bool goes_on = iteration_.goes_on();
  if (!(goes_on ? looks_at_truncation_ : limits_truncation() && iteration_.solved())) return false;
  const double theta = iteration_.contraction();
  if (goes_on && !(theta >= 0.0 && theta < 1.0)) return false;  // nothing is known yet
  const double seen = truncation(), left = goes_on ? truncation_change() * std::max(1.0, theta / (1.0 - theta)) : 0.0;
  looks_at_truncation_ = seen + left > truncation_limit_;
  // Where it is lost in what the solution of the stage equations resolves, shorter steps leave out no less.
  too_long_ = seen > truncation_limit_ + left && seen > resolution();
  if (too_long_) why_ = "the step is too long for its stages";
  return too_long_;
}

void Integrator::judge_iteration() {
  ++stage_iterations_;
  if (keeps_rows_)
    iteration_.judge(stages_, constraints_->rounding());
  else
    iteration_.judge(stages_);
  if (iteration_.forgets_acceleration()) acceleration_.clear();
}

void Integrator::accelerate() {
  const int s = stages_.count(), S = stages_.padded(), nv = tree_->nv;
  for (VecX* x : {&iterate_, &correction_, &left_}) x->resize(nv * s);
  for (int d = 0; d < nv; ++d) {
    std::copy_n(stages_.v() + d * S, s, iterate_.data() + d * s);
    std::copy_n(stages_.dv() + d * S, s, correction_.data() + d * s);
    std::copy_n(stages_.residual() + d * S, s, left_.data() + d * s);
  }
  acceleration_.apply(iterate_, correction_, left_);
  for (int d = 0; d < nv; ++d)
    for (int i = 0; i < S; ++i) stages_.v()[d * S + i] = iterate_[d * s + std::min(i, s - 1)];
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
  const bool may_look_ahead = tau.size() == 0 && this->may_look_ahead(h);
  if (may_look_ahead && take_ahead(q0, p0, h)) return true;
  ahead_.drop();
  from_ahead_ = false;
  // Impact maps solve one step again and again from other momenta: its own velocities are then the best start.
  const bool again = start_.count() == 0 && solved_ && h == h_ && (q0.array() == q0_.array()).all();
  begin(q0, p0, h, tau);
  part_ = false;
  stage_iterations_ = 0;
  why_ = "";
  too_long_ = false;
  const int s = stages_.count();
  const auto fits = [this] { return !too_long_ && ends_well(); };
  if (again && settles()) return fits();
  Guide* guide = std::exchange(guide_, nullptr);
  if (guide != nullptr && guide->lead(guide_time_, h, start_, stages_) && settles()) return fits();
  if (may_look_ahead) {
    ask_ahead();
    if (take_ahead(q0_, p0_, h)) return true;
    ahead_.count_step_alone();
  }
  if (start_.count() > 0) {
    start_.extrapolate(h, stages_);
    if (settles()) return fits();
    if (s > 2) {
      start_.extrapolate_smoothed(h, stages_);
      if (settles()) return fits();
    }
  }
  if (!node_velocity(q0_, p0_, v0_)) {
    why_ = "the mass matrix is not positive definite";
    return false;
  }
  start_constant(v0_);
  if (settles()) return fits();
  // A shorter step costs less than a ramp, which takes several and then the long one.
  return !limits_truncation() && start_by_ramp(tau) && fits();
}

// Whether the steps from here on are likely to go on as the last ones did, with no inputs that may change.
bool Integrator::may_look_ahead(double h) const {
  return flies_ && !newton_ && (servo() == nullptr || !servo()->any) && start_.is_even(h);
}

// For steps in advance from the state where the step begins.
void Integrator::ask_ahead() {
  if (!ahead_.is_worth_asking()) return;
  if (stages_.has_extra_forces()) return ahead_.pause();
  asks_ahead_ = true;
  company_->iterate(*this, *lanes_);
  asks_ahead_ = false;
}

int Integrator::look_ahead(const VecCRef& q0, const VecCRef& p0, double h) {
  if (!may_look_ahead(h)) return 0;
  if (!ahead_.any() && ahead_.is_worth_asking()) {
    static const VecX none;
    begin(q0, p0, h, none);
    solved_ = false;
    ask_ahead();
  }
  return ahead_.is(q0, p0, h, iteration_.tol()) ? ahead_.left() : 0;
}

// The step from this state, if it was solved in advance: all is as it would be had it been solved now, but for the
// factor.
bool Integrator::take_ahead(const VecCRef& q0, const VecCRef& p0, double h) {
  if (!ahead_.is(q0, p0, h, iteration_.tol())) return false;
  if (q0.data() != q0_.data()) q0_ = q0;
  if (p0.data() != p0_.data()) p0_ = p0;
  h_ = h;
  stages_.set_time(time_);
  show_ahead(0);
  count_ahead(0);
  solved_ = from_ahead_ = true;
  return true;
}

void Integrator::show_ahead(int after) {
  const int n = tree_->nv;
  const auto copy = [&](StepsAhead::Part part, double* to) { std::copy_n(ahead_.next(after, part), n, to); };
  copy(StepsAhead::kV, stages_.v());
  copy(StepsAhead::kX, stages_.X());
  copy(StepsAhead::kMomentum, stages_.P());
  copy(StepsAhead::kForce, stages_.G());
  copy(StepsAhead::kCorrection, stages_.dv());
  h_ = ahead_.length();
  part_ = false;
  why_ = "";
}

void Integrator::count_ahead(int after) {
  stage_iterations_ = ahead_.iterations(after);
  counters.stage_iterations += stage_iterations_;
  ++counters.factorizations;
  residual_ = ahead_.error(after);
}

void Integrator::accept_ahead(int after) {
  const int nq = tree_->nq, nv = tree_->nv;
  show_ahead(after);
  for (int k = 0; k <= after; ++k) {
    count_ahead(k);
    if (after - k < StartValues::kSteps) start_.push(ahead_.next(k, StepsAhead::kV), h_);
  }
  std::copy_n(after == 0 ? ahead_.q0().data() : ahead_.next(after - 1, StepsAhead::kQ), nq, q0_.data());
  std::copy_n(after == 0 ? ahead_.p0().data() : ahead_.next(after - 1, StepsAhead::kP), nv, p0_.data());
  std::copy_n(ahead_.next(after, StepsAhead::kCarryQ), nq, carry_q_.data());
  std::copy_n(ahead_.next(after, StepsAhead::kCarryP), nv, carry_p_.data());
  stages_.set_time(time_);
  counters.steps += after + 1;
  ahead_.advance(after + 1);
  solved_ = true;
  from_ahead_ = false;
}

void Integrator::finish(VecRef q1, VecRef p1) {
  if (keeps_rows_) {
    q1 = q1_;
    p1 = p1_;
    return;
  }
  if (!from_ahead_) return StepEquations::finish(q1, p1);
  const int nq = tree_->nq, nv = tree_->nv;
  std::copy_n(ahead_.next(0, StepsAhead::kQ), nq, q1.data());
  std::copy_n(ahead_.next(0, StepsAhead::kP), nv, p1.data());
  std::copy_n(ahead_.next(0, StepsAhead::kCarryQ), nq, next_carry_q_.data());
  std::copy_n(ahead_.next(0, StepsAhead::kCarryP), nv, next_carry_p_.data());
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
    if (keeps_rows_ && !ends_well()) return false;
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
  return solve_part(path, alpha, q0, p0, tau, std::min(iteration_.tol(), kCloseTolerance));
}

bool Integrator::solve_part(const StepPath& path, double alpha, const VecCRef& q0, const VecCRef& p0, const VecX& tau,
                            double tol) {
  const GaussTable& table = stages_.table();
  const int s = stages_.count(), S = stages_.padded();
  // A step that keeps rows and was solved from the same state, in the search for an event, tells what this one is off
  // from the path as well, and what its impulses are.
  const double solved_part = h_ / path.h();
  const bool again = keeps_rows_ && s > 1 && solved_ && stages_.start_time() == time_ &&
                     (q0.array() == q0_.array()).all() && (p0.array() == p0_.array()).all();
  if (again) {
    off_path_.resize(tree_->nv, s);
    for (int i = 0; i < s; ++i) {
      path.velocity(solved_part * table.c[i], v0_);
      for (int d = 0; d < tree_->nv; ++d) off_path_(d, i) = stages_.v()[d * S + i] - v0_[d];
    }
    constraints_->keep_start();
  }
  from_ahead_ = false;
  begin(q0, p0, alpha * path.h(), tau);
  part_ = true;
  stage_iterations_ = 0;
  why_ = "";
  for (int i = 0; i < s; ++i) {
    path.velocity(alpha * table.c[i], v0_);
    if (again) v0_ += off_path_.col(i);
    for (int d = 0; d < tree_->nv; ++d) stages_.v()[d * S + i] = v0_[d];
  }
  for (int i = s; i < S; ++i)
    for (int d = 0; d < tree_->nv; ++d) stages_.v()[d * S + i] = v0_[d];
  keeps_factor_ = again && constraints_->start_again(alpha / solved_part);
  const double own = iteration_.tol();
  iteration_.set_tol(tol);
  bool solved = solve_stages();
  if (!solved && node_velocity(q0_, p0_, v0_)) {
    start_constant(v0_);
    if (again) begin(q0, p0, alpha * path.h(), tau);
    solved = solve_stages();
  }
  iteration_.set_tol(own);
  solved_ = solved && ends_well();
  return solved_;
}

void Integrator::accept() {
  ++counters.steps;
  carry_q_.swap(next_carry_q_);
  carry_p_.swap(next_carry_p_);
  start_.push(stages_, h_);
  if (keeps_rows_) constraints_->accept();
  if (from_ahead_) ahead_.advance(1);
  from_ahead_ = false;
}

void Integrator::forget() {
  ahead_.drop();
  from_ahead_ = false;
  carry_q_.setZero();
  carry_p_.setZero();
  start_.forget();
  if (keeps_rows_) constraints_->forget();
}

void Integrator::join(LaneCompany* company) {
  company_ = company;
  // The factor of stiff elements is not the kernel's alone.
  const bool shares = company != nullptr && stages_.count() == 1 && !stiff_.any();
  lanes_ = shares ? &company->lanes_of(*this) : nullptr;
  flies_ = shares && !tree_->has_springs && can_fly(*tree_);
  ahead_.drop();
}

void Integrator::start_anew() {
  forget();
  solved_ = newton_ = false;
  std::fill_n(stages_.P(), tree_->nv * stages_.padded(), 0.0);  // the first iteration measures with them
}

Integrator::Memory Integrator::memory() {
  solved_ = from_ahead_ = false;  // the stages are not remembered
  const Eigen::Map<const MatX> P(stages_.P(), stages_.padded(), tree_->nv);
  return {
      start_.history(), carry_q_, carry_p_, P.topRows(stages_.count()), constraints_ ? constraints_->forces() : VecX(),
      newton_};
}

void Integrator::recall(const Memory& memory) {
  ahead_.drop();
  start_.recall(memory.start);
  carry_q_ = memory.carry_q;
  carry_p_ = memory.carry_p;
  Eigen::Map<MatX> P(stages_.P(), stages_.padded(), tree_->nv);
  for (int i = 0; i < stages_.padded(); ++i) P.row(i) = memory.momenta.row(std::min(i, stages_.count() - 1));
  newton_ = memory.newton;
  if (constraints_) constraints_->start_from(memory.constraint_forces);
  solved_ = false;
}

double Integrator::modified_hamiltonian(double t, const VecCRef& q, const VecCRef& p, double h) {
  return contactvi::modified_hamiltonian(*this, q, p, h, t);
}

}  // namespace contactvi

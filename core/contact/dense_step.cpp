#include "contact/dense_step.hpp"

#include <algorithm>
#include <cmath>

#include "base/tolerances.hpp"
#include "cone/turning_law.hpp"
#include "contact/dense_energy.hpp"
#include "step/path.hpp"
#include "step/projection.hpp"

namespace contactvi {

namespace {
constexpr int kStageIterations = 40;
constexpr double kStageRounding = 1e-14;  // of the velocities: the smooth equation is solved
constexpr double kStageStalled = 1e-10;   // of the velocities: accepted where rounding stops the iterations
constexpr int kGapIterations = 30, kFirstGapIterations = 3;
constexpr double kGapStalled = 0.9;  // share of the error that an iteration after the first ones may leave
constexpr int kLawRounds = 4;        // times that the whole law is solved again for loaded gaps that open
constexpr double kLawStalled = 0.5;  // share of the widest such gap that a round may leave
// Residual of the normal problem in a gap iteration: a share of the gaps that count as zero, over the step; at least
// rounding.
constexpr double kNormalsShare = 0.1, kNormalsRounding = 1e-12;
constexpr int kAdditions = 16;             // times that points join the candidates of one step
constexpr double kTouching = 1e-11;        // [m] a closed point without load takes part in the velocity impulse
constexpr double kFastFall = 4.0;          // contacts that close faster than this many g h have restitution
constexpr double kWider = 1.5;             // of the motion's bound, where the step has left it
constexpr double kEnergyRounding = 1e-13;  // of the energies
constexpr double kCurvature = 1e-4;        // of the kinetic energy: the error of a smooth step is less
constexpr double kToAnOrder = 10.0;        // times the change of the acceleration: an estimate of the same order
constexpr double kBothEnds = 2.0;          // the force of a contact acts half at the start of the step, half at its end
constexpr double kLifted = 1e-7;  // of the kinetic energy: what an impact moves gaps by within their rounding is less
// Of what servos, inputs and dampers exchange in a step: stiff ones change the velocities at its ends, where impulses
// of contacts act, more than that in its middle.
constexpr double kWorkShare = 1e-3;
constexpr double kEnergyShare = 1e-8;  // of the kinetic energy: smaller gains are not worth a shorter step

// An answer that meets Coulomb's law to 1e-4 of the largest free speed is below the error of the step where impacts lie
// inside of it; where none do the sweeps and Newton's method reach 1e-8.
constexpr double kLawAccepted = 1e-4, kLawSolved = 1e-8;
constexpr int kLawFactors = 60;
constexpr double kUsualTolerance = 1e-12;  // of steps, to which these belong
constexpr double kClosest = 1e-3;          // share of what is usually left that a tolerance may ask for

double size_of(const Energy& e) { return std::abs(e.kinetic) + std::abs(e.potential); }
double total(const Energy& e) { return e.kinetic + e.potential; }
}  // namespace

DenseStep::DenseStep(const Scene& scene, Guards& guards, double tol)
    : scene_(&scene),
      guards_(&guards),
      integrator_(scene.tree),
      candidates_(scene, guards),
      rows_(scene),
      end_rows_(scene),
      usual_closeness_(std::clamp(tol / kUsualTolerance, kClosest, 1.0)) {
  const Tree& tree = scene.tree;
  for (VecX* x : {&p0_, &v0_, &v_free_, &v_, &v1_, &p1_, &p_start_, &bound_, &work_}) *x = VecX::Zero(tree.nv);
  for (VecX* x : {&q0_, &q1_}) x->setZero(tree.nq);
  const int rows = tree.elements.constraint_rows;
  for (Constraints* node : {&start_, &end_}) {
    node->W.setZero(tree.nv, rows);
    node->whole = node->W;
    for (VecX* x : {&node->phi, &node->rate, &node->mu}) x->setZero(rows);
  }
  restart();
}

BlockOptions DenseStep::solver_options() const {
  BlockOptions options;
  options.tolerance = kLawSolved * closeness_;
  options.accept = kLawAccepted;
  options.factors = kLawFactors;
  return options;
}

void DenseStep::restart() {
  memory_ = Memory();
  memory_.joint_friction.setZero(static_cast<Eigen::Index>(scene_->tree.elements.friction_dofs.size()));
}

bool DenseStep::fail(const char* why) {
  why_ = why;
  return false;
}

void DenseStep::note(const BlockResult& result) {
  ++counters.problems;
  counters.sweeps += result.sweeps;
  counters.factorizations += result.factors;
}

// The whole law of the present problem from the impulses lambda_, for the velocity v, with the constraints of a node.
BlockResult DenseStep::solve_law(double bound_energy, VecX& v, const Constraints& node) {
  if (problems_) problems_->add(ProblemLog::Blocks{rows_.problem(), node.W, lambda_, bound_energy});
  BlockResult result = solver_.solve(rows_.problem(), bound_energy, solver_options(), lambda_, v);
  note(result);
  if (follows_forces_) settle_friction(bound_energy, v, result);
  return result;
}

void DenseStep::account(const BlockResult& result) {
  report_.residual = std::max(report_.residual, result.residual);
  using Stage = BlockResult::Stage;
  report_.repaired +=
      result.stage == Stage::kRepaired || result.stage == Stage::kBlended || result.stage == Stage::kFailed;
}

// --- the smooth equation ---

bool DenseStep::iterate_stage() {
  double last = INFINITY;
  for (int k = 0; k < kStageIterations; ++k) {
    double change = integrator_.iterate(p_start_, false, false);
    if (!std::isfinite(change)) break;
    integrator_.stage_velocity(v_);
    if (constrained()) change = std::max(change, hold_constraints());
    const double size = 1.0 + v_.cwiseAbs().maxCoeff();
    if (change <= kStageRounding * size) return true;
    if (change > 0.5 * last && change <= kStageStalled * size) return true;
    // What the next iterations would change, at the rate of these or of the last ones in this step.
    if (k > 0) contraction_ = change / last;
    if (contraction_ < 0.5 && change * contraction_ / (1.0 - contraction_) <= kStageRounding * size) return true;
    last = change;
  }
  return fail("the smooth equation of a dense step was not solved");
}

void DenseStep::set_start_momentum() {
  p_start_ = p0_;
  if (adheres_)
    rows_.add_impulses(lambda_ - pull_, p_start_);
  else
    rows_.add_impulses(lambda_, p_start_);
  if (constrained()) p_start_ += start_.whole * start_.mu;
}

// Bodies are at rest where they move no further in the step than gaps are usually solved to. What is left of the law
// there is a motion that all such steps repeat.
void DenseStep::set_closeness() {
  const bool at_rest = v0_.cwiseAbs().maxCoeff() * h_ <= kGapSolved;
  closeness_ = at_rest ? kGapSolvedAtRest / kGapSolved : usual_closeness_;
  gap_solved_ = kGapSolved * closeness_;
}

bool DenseStep::solve_smooth(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) {
  q0_ = q0;
  p0_ = p0;
  h_ = h;
  if (!integrator_.node_velocity(q0, p0, v0_)) return fail("the mass matrix is not positive definite");
  set_closeness();
  integrator_.begin(q0, h, tau, v0_);
  p_start_ = p0;
  if (!std::isfinite(integrator_.iterate(p_start_, true, true))) return fail("a number is not finite");
  rows_.clear();
  lambda_.resize(0);
  adheres_ = false;
  start_.mu.setZero();
  end_.mu.setZero();
  contraction_ = 1.0;
  const auto take_masses = [this] {
    rows_.set_masses([this](MatX& X) { integrator_.solve_step_matrix(X); });
    solver_.set_equations(rows_.problem(), start_.W);
  };
  if (constrained()) {
    evaluate(q0_, t_, start_);
    take_masses();
  }
  if (!iterate_stage()) return false;
  take_masses();
  if (!masses_are_positive()) return fail("the masses of a dense step are not positive");
  v_free_ = v_;
  return true;
}

bool DenseStep::masses_are_positive() const {
  const BlockProblem& problem = rows_.problem();
  for (int b = 0; b < problem.blocks(); ++b)
    if (!problem.M.positive(b)) return false;
  return true;
}

// Velocities of the step without contacts reach from v0 to 2 v - v0.
void DenseStep::bound_velocities() {
  bound_.setZero();
  add_size(scene_->tree, v0_, 1.0, bound_);
  v1_ = 2.0 * v_free_ - v0_;
  work_.setZero();
  add_size(scene_->tree, v1_, 1.0, work_);
  bound_ = bound_.cwiseMax(work_);
}

// --- position impulse ---

// The gaps of the active contacts at the end of the step with the velocity v_; returns how far the law of the gaps is
// from being met: a loaded contact is open, or any contact overlaps [m].
double DenseStep::place_end() {
  integrate(scene_->tree, q0_, v_, h_, q1_);
  guards_->place(q1_);
  double error = 0.0;
  for (std::size_t k = 0; k < active_.size(); ++k) {
    DenseContact& c = candidates_.contacts()[active_[k]];
    const BlockContact& block = rows_.block(k);
    candidates_.evaluate(c.law, c.at1);
    const double gap = c.at1.gap - c.allowed, n = lambda_[block.row];
    const double least = c.turns()
                             ? least_normal(c.mu, lambda_.segment<3>(block.row), lambda_.segment<3>(turning_row(k)))
                         : block.rows == 3 ? lambda_.segment<2>(block.row + 1).norm() / c.mu
                                           : 0.0;
    // What the normal impulse above its bound moves the contact by in the step: a gap that is open counts up to that.
    const double lift = std::max(0.0, n - least) * mobility_[k] * h_;
    const double off = std::max(-gap, std::min(gap, lift));
    if (off > gap_solved_) error = std::max(error, off);
  }
  return error;
}

// What the gap of the active contact i at the end of the step, linearized about its present motion, is at rest, over h.
double DenseStep::offset(const DenseContact& c, std::size_t i) const {
  const double at_rest = (c.at1.gap - c.allowed) / h_ - rows_.velocity(i, 0, v_);
  return kept_ == Kept::kEnergy ? std::max(0.0, at_rest) : at_rest;
}

// The impulses have been changed and v_ with them: the smooth equation again, then the normal impulses for the gaps
// that it leads to, until the gaps of loaded contacts are zero and none overlaps. scale: of speeds [m/s].
bool DenseStep::gap_iterations(double scale) {
  const double tolerance = std::max(kNormalsRounding, kNormalsShare * gap_solved_ / (h_ * scale));
  double last = INFINITY;
  for (int k = 0;; ++k) {
    set_start_momentum();
    if (!iterate_stage()) return false;
    const double error = place_end();
    const bool stalls = k > kFirstGapIterations && error > kGapStalled * last;
    if (error == 0.0 || k >= kGapIterations || stalls) return true;
    last = error;
    // v = v_free + M^-1 W lambda holds for the present v and lambda.
    BlockProblem& problem = rows_.problem();
    solver_.free_velocity(problem, lambda_, v_, problem.v_free);
    for (std::size_t i = 0; i < active_.size(); ++i) {
      problem.offset[rows_.block(i).row] = offset(contacts()[active_[i]], i);
    }
    work_ = v_;
    ++counters.gap_iterations;
    note(solver_.solve_normals(problem, tolerance, lambda_, v_));
    work_ = v_ - work_;
    integrator_.add_velocity(work_);
  }
}

// The slip of a contact that lasts is the mean of those at both ends of the step, with the velocity v_ of the step
// without contacts at the end: with the one at the start alone friction would be of first order where bodies turn.
void DenseStep::set_slips() {
  std::vector<DenseContact>& all = candidates_.contacts();
  lasting_.clear();
  for (int i : active_) {
    DenseContact& c = all[i];
    if (c.rows() == 1 || !c.loaded()) continue;
    c.t1_1 = end_tangent(c);
    c.drift1 = drift(c, true);
    c.turning_drift1 = turning_drift(c, true);
    lasting_.push_back(i);
  }
  end_rows_.set(all, lasting_, true, guards_->placements(), h_);
  for (std::size_t i = 0, k = 0; i < active_.size() && k < lasting_.size(); ++i) {
    if (active_[i] != lasting_[k]) continue;
    for (int r = 1; r < 3; ++r)
      rows_.problem().offset[rows_.block(i).row + r] =
          0.5 * (end_rows_.velocity(k, r, v_) - rows_.velocity(i, r, v_)) +
          0.5 * (all[active_[i]].drift0[r - 1] + all[active_[i]].drift1[r - 1]);
    const DenseContact& c = all[active_[i]];
    for (int r = 0; r < 3 && c.turns(); ++r)
      rows_.problem().offset[turning_row(i) + r] =
          0.5 * (end_rows_.velocity(end_rows_.block(k).turning, r, v_) - rows_.velocity(rows_.block(i).turning, r, v_) +
                 c.turning_drift0[r] + c.turning_drift1[r]);
    ++k;
  }
}

// The natural map of loaded contacts that are open at the end of the step [m]: the gap, or what the normal impulse
// moves the contact by, whichever is less.
double DenseStep::widest_loaded_gap() const {
  double widest = 0.0;
  for (std::size_t i = 0; i < active_.size(); ++i) {
    const DenseContact& c = contacts()[active_[i]];
    const double gap = c.at1.gap - c.allowed;
    if (gap > gap_solved_) widest = std::max(widest, std::min(gap, lambda_[rows_.block(i).row] * mobility_[i] * h_));
  }
  return widest;
}

// The first tangent of a contact at the end of the step, where the bodies are placed.
Vec3 DenseStep::end_tangent(const DenseContact& c) {
  if (!scene_->is_pair(c.point.guard)) return Vec3::Zero();
  return guards_->has_axis(c.point.guard) ? guards_->tangent(c.point.guard, c.at1.normal)
                                          : carried_tangent(c.t1_0, c.at0.normal, c.at1.normal);
}

// The whole law, with the gaps linearised about the end of the present motion, then the gap iterations.
bool DenseStep::position_problem() {
  std::vector<DenseContact>& all = candidates_.contacts();
  active_.clear();
  for (int i = 0; i < static_cast<int>(all.size()); ++i) active_.push_back(i);
  ++counters.passes;
  integrator_.stage_velocity(v_);
  guards_->place(q0_);
  rows_.set(all, active_, false, guards_->placements(), h_);
  for (DenseContact& c : all) {
    c.drift0 = drift(c, false);
    c.turning_drift0 = turning_drift(c, false);
  }
  set_friction();
  BlockProblem& problem = rows_.problem();
  lambda_.setZero(problem.rows());
  mobility_.assign(active_.size(), 0.0);
  place_end();
  if (recorder_) recorder_->start_pass(all, q1_, v_, lambda_, start_.mu);
  for (std::size_t i = 0; i < active_.size(); ++i) {
    const DenseContact& c = all[active_[i]];
    const BlockContact& block = rows_.block(i);
    problem.offset[block.row] = offset(c, i);
    if (block.rows == 3) problem.offset.segment<2>(block.row + 1) = c.drift0;
    lambda_.segment(block.row, block.rows) = c.position.head(block.rows);
    if (c.turns()) {
      lambda_.segment<3>(turning_row(i)) = c.position_turning;
      problem.offset.segment<3>(turning_row(i)) = c.turning_drift0;
    }
    mobility_[i] = rows_.mobility(i);
  }
  set_slips();
  if (recorder_) recorder_->set_lasting(lasting_);
  lambda_.tail(joint_friction_.size()) = joint_friction_;
  problem.v_free = v_free_;
  solver_.prepare(problem);
  set_pulls();
  if (adheres_) solver_.free_velocity(problem, pull_, v_free_, problem.v_free);
  BlockResult result;
  double last = INFINITY;
  // Velocities, and the impulses with which they are, less those of adhesion.
  VecX from = v_free_, before = adheres_ ? pull_ : VecX(VecX::Zero(problem.rows()));
  for (int k = 0;; ++k) {
    work_ = v_;
    // The energy is bounded at the end of the step, where the speeds of closed contacts are those of the law.
    result = solve_law(INFINITY, v_, start_);
    if (!v_.allFinite()) return fail("a number is not finite");
    if (recorder_) recorder_->take_law(lambda_, multipliers(v_ - from, lambda_ - before), v_);
    work_ = v_ - work_;
    integrator_.add_velocity(work_);
    if (!gap_iterations(result.scale)) return false;
    if (recorder_) recorder_->take_round(all, q1_, v_, lambda_, start_.mu);
    // Friction that slides holds the normal impulse of a gap that opens, which breaks the law as a speed of that gap
    // over h does: where that is more than an accepted residual, the whole law again, about this motion.
    const double open = widest_loaded_gap() / h_;
    result.residual = std::max(result.residual, open / result.scale);
    if (open <= kLawAccepted * closeness_ * result.scale || k >= kLawRounds || open > kLawStalled * last) break;
    last = open;
    from = v_;
    before = lambda_;
    for (std::size_t i = 0; i < active_.size(); ++i) problem.offset[rows_.block(i).row] = offset(all[active_[i]], i);
    solver_.free_velocity(problem, lambda_, v_, problem.v_free);
  }
  account(result);
  for (std::size_t i = 0; i < active_.size(); ++i) {
    DenseContact& c = all[active_[i]];
    const BlockContact& block = rows_.block(i);
    // The solver's rounding at points that stay open.
    const double lift = lambda_[block.row] * mobility_[i] * h_;
    const bool open = c.at1.gap - c.allowed > gap_solved_ && lift <= gap_solved_;
    if (open) lambda_.segment(block.row, block.rows).setZero();
    c.position.setZero();
    c.position.head(block.rows) = lambda_.segment(block.row, block.rows);
    if (!c.turns()) continue;
    if (open) lambda_.segment<3>(turning_row(i)).setZero();
    c.position_turning = lambda_.segment<3>(turning_row(i));
  }
  joint_friction_ = lambda_.tail(joint_friction_.size());
  return true;
}

// The position impulse, again as long as points that are no candidates overlap at the end; then q1_, and p1_ before the
// velocity impulse.
bool DenseStep::position_impulses() {
  joint_friction_ = h_ * memory_.joint_friction;
  candidates_.begin(q0_, h_, nominal_h_);
  q_free_ = q1_;
  candidates_.collect(bound_, q_free_, memory_.impulses);
  for (int k = 0; k < kAdditions; ++k) {
    if (!position_problem()) return false;
    // Impulses may have made a body faster than the bound with which the candidates were found.
    work_.setZero();
    add_size(scene_->tree, v_, 1.0, work_);
    if ((work_ - bound_).maxCoeff() > 0.0) {
      bound_ = bound_.cwiseMax(kWider * work_);
      candidates_.collect(bound_, q_free_, memory_.impulses);
    }
    if (!candidates_.add_overlapping(q1_, active_.size(), memory_.impulses)) break;
  }
  report_.gap = candidates_.gap();
  // Points that joined after the last solution have no impulse: they do not overlap, or the step is refused.
  candidates_.contacts().resize(active_.size());
  for (std::size_t i = 0; i < active_.size(); ++i) set_restitution(i);
  set_start_momentum();
  joint_friction_loss_ = -joint_friction_work(lambda_, v_);
  integrator_.set_start_momentum(p_start_);
  integrator_.finish(q1_, p1_);
  if (recorder_) recorder_->take_position(lambda_, start_.mu, p1_);
  return true;
}

// --- velocity impulse ---

bool DenseStep::velocity_impulses(double bound_energy) {
  guards_->place(q1_);
  std::vector<DenseContact>& all = candidates_.contacts();
  active_.clear();
  for (int i = 0; i < static_cast<int>(all.size()); ++i) {
    DenseContact& c = all[i];
    // A point whose gap is larger than what its impulse moves it by is open: that impulse is an error of the solver.
    const double lift = c.position[0] * mobility_[i] * h_;
    c.closed = c.at1.gap <= std::max(kTouching, lift);
    c.t1_1 = end_tangent(c);
    c.drift1 = drift(c, true);
    c.turning_drift1 = turning_drift(c, true);
    if (c.closed) active_.push_back(i);
  }
  if (adheres_) pull_at_end();
  work_ = v1_;
  rows_.set_masses([this](MatX& X) { integrator_.solve_masses(X); });
  if (!masses_are_positive()) return fail("the masses of a dense step are not positive");
  rows_.set(all, active_, true, guards_->placements(), h_);
  BlockProblem& problem = rows_.problem();
  if (constrained()) {
    evaluate(q1_, t_ + h_, end_);
    solver_.set_equations(problem, end_.W);
    solver_.project(-end_.rate, v1_);
  }
  lambda_.setZero(problem.rows());
  for (std::size_t i = 0; i < active_.size(); ++i) {
    const BlockContact& block = rows_.block(i);
    lambda_.segment(block.row, block.rows) = all[active_[i]].velocity.head(block.rows);
    if (block.rows == 3) problem.offset.segment<2>(block.row + 1) = all[active_[i]].drift1;
    if (!all[active_[i]].turns()) continue;
    lambda_.segment<3>(turning_row(i)) = all[active_[i]].velocity_turning;
    problem.offset.segment<3>(turning_row(i)) = all[active_[i]].turning_drift1;
  }
  lambda_.tail(joint_friction_.size()) = joint_friction_;
  problem.v_free = v1_;
  solver_.prepare(problem);
  account(solve_law(bound_energy, v1_, end_));
  rows_.add_impulses(lambda_, p1_);
  if (recorder_) recorder_->take_plastic(active_, lambda_, multipliers(v1_ - work_, lambda_), v1_);
  lambda_end_ = lambda_;
  expand(bound_energy);
  return v1_.allFinite() && p1_.allFinite() ? true : fail("a number is not finite");
}

// Whether a contact that closes as it does is one that has restitution.
bool DenseStep::closes_fast(const DenseContact& c) const {
  return c.closing < -kFastFall * scene_->tree.gravity.norm() * h_;
}

// Poisson's restitution: the contacts that closed fast expand with an impulse of at least e times what compressed them.
void DenseStep::expand(double bound_energy) {
  BlockProblem& problem = rows_.problem();
  bool any = false;
  lambda_.setZero();
  for (std::size_t i = 0; i < active_.size(); ++i) {
    DenseContact& c = candidates_.contacts()[active_[i]];
    BlockContact& block = problem.contacts[i];
    const double compression = c.position[0] + lambda_end_[block.row];
    c.expands = c.restitution > 0.0 && closes_fast(c) && compression > 0.0;
    if (c.expands) block.lower = c.restitution * compression;
    any |= c.expands;
  }
  if (!any) return;
  // The friction of joints in the expansion is what their bound has left.
  for (std::size_t i = rows_.first_joint(); i < problem.contacts.size(); ++i) {
    BlockContact& joint = problem.contacts[i];
    joint.box = std::max(kLeastDivisor, joint.box - std::abs(lambda_end_[joint.row]));
  }
  problem.v_free = v1_;
  const VecX plastic = v1_;
  account(solve_law(INFINITY, v1_, end_));
  // Energy, cone and gaps are convex conditions: a share of the expansion keeps them as the whole and none of it do.
  const double share = kinetic_share(problem, plastic, v1_, bound_energy);
  if (recorder_) recorder_->take_expansion(active_, lambda_, multipliers(v1_ - plastic, lambda_), v1_, share);
  if (share < 1.0) {
    lambda_ *= share;
    v1_ = plastic + share * (v1_ - plastic);
    ++report_.repaired;
  }
  rows_.add_impulses(lambda_, p1_);
  lambda_end_ += lambda_;
}

// --- the step ---

// What contacts add to the error of the step without them: gaps are wrong by what the gap iterations leave, and at the
// start by rounding, which changes the energy by force times gap; and what the step conserves differs from H. What the
// solver leaves of Coulomb's law may not gain anything.
double DenseStep::contacts_error(const Energy& before, const Energy& free, const Energy& middle) const {
  double lifts = 0.0, most_noise = 0.0;
  bool impact = false;
  for (const DenseContact& c : contacts()) {
    const double noise = std::max(DenseCandidates::kGapPromised, candidates_.noise(c.point.guard));
    most_noise = std::max(most_noise, noise);
    lifts += kBothEnds * c.position.norm() * (gap_solved_ + std::clamp(-c.at0.gap, 0.0, noise));
    impact |= c.position[0] > 0.0 && closes_fast(c);
  }
  const double smooth = kCurvature * std::max(before.kinetic, free.kinetic);
  const double curved =
      impact || memory_.change.size() != v_.size()
          ? 0.0
          : kToAnOrder * curvature_error(rows_.problem(), 2.0 * (v_ - v0_), memory_.change * (h_ / memory_.h));
  // As far as the impulses are those of the forces so far and of the motion.
  double forces = 0.0;
  for (const Joint& joint : scene_->tree.joints) forces += joint.mass * scene_->tree.gravity.norm();
  for (const DenseImpulse& last : memory_.impulses) forces += last.position_force.norm() + last.velocity_force.norm();
  const double lifted = kBothEnds * forces * (gap_solved_ + most_noise) + kLifted * before.kinetic;
  const double exchanged = std::abs(integrator_.input_work()) + integrator_.damping_loss();
  return std::min(lifts / h_, lifted) + std::min(curved, smooth) + kWorkShare * exchanged +
         kEnergyShare * before.kinetic + turning_error(scene_->tree, v_, h_, before, free, middle);
}

bool DenseStep::solve(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau, Kept kept) {
  why_ = "";
  violated_constraint_ = -1;
  kept_ = kept;
  report_ = DenseReport();
  if (!solve_smooth(q0, p0, h, tau)) return false;
  if (recorder_) recorder_->begin(q0_, p0_, t_, h, kept == Kept::kEnergy);
  const Energy before = energy(integrator_, q0, p0, v0_);
  integrator_.set_start_momentum(p_start_);
  integrator_.finish(q1_, p1_);
  if (constrained()) {
    integrator_.place_node(q1_);
    close_rates(integrator_, reduction_, end_.whole, end_.rate, p1_, work_, end_.mu);
  }
  const Energy free = energy(integrator_, q1_, p1_);
  const double smooth_error = std::abs(total(free) - total(before) - integrator_.work() - constraint_work());
  if (recorder_) recorder_->take_masses(rows_.problem());
  bound_velocities();
  if (!position_impulses()) return false;
  integrator_.place_node(q1_);
  v1_ = p1_;
  integrator_.solve_mass(v1_);
  if (!v1_.allFinite()) return fail("a number is not finite");
  const Energy middle = energy(integrator_, q1_, p1_, v1_);
  report_.energy_error =
      kEnergyRounding * (size_of(before) + size_of(free)) + smooth_error + contacts_error(before, free, middle);
  // What constraints or surfaces drive does work that depends on the impulses: no bound on the energy is known before
  // them.
  const double bound = total(before) + integrator_.work() + report_.energy_error - middle.potential;
  if (!velocity_impulses(scene_->tree.elements.driven() || any_surface_moves() ? INFINITY : bound)) return false;
  if (constrained()) {
    report_.energy_error += take_reactions();
    if (!constraints_met()) return fail("the constraints cannot be met");
  }
  // Both impulses with the displacement of the step, as in contact steps: the friction is constant along it.
  joint_friction_loss_ -= joint_friction_work(lambda_end_, v_);
  set_results(lambda_end_);
  const double change = 0.5 * p1_.dot(v1_) + middle.potential - total(before) -
                        (integrator_.work() + driven_work() - joint_friction_loss_);
  report_.energy_rise = std::max(0.0, change - report_.energy_error);
  report_.energy_loss = -change;
  if (recorder_) {
    recorder_->finish(contacts(), q1_, p1_, v1_, gap_solved_);
    record().residual = report_.residual;
    record().repaired = report_.repaired;
  }
  return q1_.allFinite() && std::isfinite(change) ? true : fail("a number is not finite");
}

// Work [J] of the impulses of joint friction in a problem with its rows, at the velocity v.
double DenseStep::joint_friction_work(const VecX& lambda, const VecX& v) const {
  double work = 0.0;
  for (std::size_t i = rows_.first_joint(); i < rows_.problem().contacts.size(); ++i)
    work += lambda[rows_.block(i).row] * rows_.velocity(i, 0, v);
  return work;
}

// Impulses and slips at the end.
void DenseStep::set_results(const VecX& lambda) {
  std::vector<DenseContact>& all = candidates_.contacts();
  for (DenseContact& c : all) {
    c.velocity.setZero();
    c.velocity_turning.setZero();
    c.turning_speed.setZero();
    c.slip_W.setZero();
    c.slip_speed = 0.0;
  }
  for (std::size_t i = 0; i < active_.size(); ++i) {
    DenseContact& c = all[active_[i]];
    const BlockContact& block = rows_.block(i);
    c.velocity.head(block.rows) = lambda.segment(block.row, block.rows);
    if (c.turns()) {
      c.velocity_turning = lambda.segment<3>(turning_row(i));
      for (int r = 0; r < 3; ++r) c.turning_speed[r] = rows_.velocity(block.turning, r, v1_) + c.turning_drift1[r];
    }
    if (block.rows == 3) {
      const Eigen::Vector2d w(rows_.velocity(i, 1, v1_), rows_.velocity(i, 2, v1_));
      c.slip_W = c.frame(true).slip(w + c.drift1);
      c.slip_speed = c.slip_W.norm();
    }
  }
  for (const DenseContact& c : all) report_.contacts += c.loaded();
}

void DenseStep::finish(VecRef q1, VecRef p1) const {
  q1 = q1_;
  p1 = p1_;
}

void DenseStep::commit() {
  work_.setZero();
  add_size(scene_->tree, v_, 1.0, work_);
  guards_->bound_motion(q0_, work_, h_);
  guards_->commit();
  memory_.change = v1_ - v0_;
  memory_.h = h_;
  memory_.joint_friction = joint_friction_ / h_;
  memory_.closed.clear();
  memory_.impulses.clear();
  for (const DenseContact& c : contacts()) {
    if (c.closed) memory_.closed.push_back(c.point.guard);
    if (!c.loaded()) continue;
    // An expansion does not go on.
    const bool pair = scene_->is_pair(c.point.guard);
    const Vec3 start = pair ? c.position_W() : c.position;
    const Vec3 end = c.expands ? start : pair ? c.velocity_W() : c.velocity;
    memory_.impulses.push_back({c.point.guard, c.point.feature, start / h_, end / h_});
    if (!c.turns()) continue;
    const Vec3 turning = c.turning_W(c.position_turning, false) / h_;
    memory_.impulses.back().position_turning = turning;
    memory_.impulses.back().velocity_turning = c.expands ? turning : Vec3(c.turning_W(c.velocity_turning, true) / h_);
  }
}

}  // namespace contactvi

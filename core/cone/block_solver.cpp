#include "cone/block_solver.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/root.hpp"
#include "cone/block_factor.hpp"
#include "cone/block_newton.hpp"
#include "cone/block_normals.hpp"
#include "cone/block_system.hpp"
#include "cone/interior_point.hpp"
#include "cone/sweep.hpp"

namespace contactvi {

namespace {

constexpr int kBetweenChecks = 5;      // sweeps
constexpr int kSweepsFirst = 15;       // where more are needed Newton steps come first: one costs about ten sweeps
constexpr int kTurningRounds = 4;      // of sweeps and Newton steps, each of twice as many sweeps as those before
constexpr int kConvexIterations = 30;  // factorizations of one convex problem
constexpr int kNormalIterations = 25;  // and of the normal problem
constexpr double kSafeTolerance = 1e-8;
constexpr double kRepairTolerance = 1e-9;
// Energies are sums of terms of their own size: equal to this share of it.
constexpr double kEnergyRounding = 1e-12;

}  // namespace

struct BlockSolver::Work {
  BlockSystem system;
  BlockFactor factor;
  BlockNewton newton;
  InteriorPoint<BlockSystem, BlockFactor> interior;
  BlockNormals normals;
  std::vector<double> no_slip;
  ConePoint point, best, safe;
  VecX free;
  bool prepared = false, analysed = false;
  double rate = 1.0;  // of the residual between the last two checks of the sweeps, at most 1
  BlockOptions options;
  BlockResult result;

  bool start(const BlockProblem& problem, VecCRef lambda);
  BlockFactor& pattern();
  void begin();
  void note();
  bool sweeps(int most, bool all = false);
  bool sweeps_lead_on(int most) const;
  bool polish();
  void clear_open();
  void interior_point();
  void last_sweeps();
  void repair();
  bool gaps_kept(const ConePoint& p) const { return -system.worst_gap(p.v) <= options.accept * system.scale(); }
  bool within(double energy, double bound) const {
    return energy <= bound + kEnergyRounding * (std::abs(bound) + result.free_energy);
  }
  void find_safe(double bound);
  void blend(double bound);
  void finish(VecRef lambda, VecRef v);
};

BlockSolver::BlockSolver() : work_(std::make_unique<Work>()) {}
BlockSolver::~BlockSolver() = default;

bool BlockSolver::Work::start(const BlockProblem& problem, VecCRef lambda) {
  result = BlockResult();
  if (!prepared || !system.start(problem) || lambda.size() != problem.rows()) return false;
  point.lambda.resize(system.contacts());
  for (int c = 0; c < system.contacts(); ++c) {
    const BlockContact& law = system.contact(c);
    point.lambda[c].setZero();
    for (int r = 0; r < law.rows; ++r)
      if (std::isfinite(lambda[law.row + r])) point.lambda[c][r] = lambda[law.row + r];
  }
  result.scale = system.scale();
  result.free_energy = system.energy(problem.v_free);
  return std::isfinite(result.free_energy);
}

// The factor, with the pattern of this problem: most problems are solved by sweeps and never ask for it.
BlockFactor& BlockSolver::Work::pattern() {
  if (!analysed) factor.analyse(system.problem());
  analysed = true;
  return factor;
}

// The start, with impulses of the cones.
void BlockSolver::Work::begin() {
  best.residual = std::numeric_limits<double>::infinity();
  rate = 1.0;
  result.stage = BlockResult::Stage::kSweeps;
  system.project(point);
  note();
}

// Computes the residual of the point and keeps the best.
void BlockSolver::Work::note() {
  point.residual = system.residual(point);
  if (point.residual < best.residual) best = point;
}

// Whether the sweeps that are left of `most` reach the tolerance, or what is accepted, at the last rate.
bool BlockSolver::Work::sweeps_lead_on(int most) const {
  const double goal = point.residual > options.accept ? options.accept : options.tolerance;
  const double checks = static_cast<double>(most - result.sweeps) / kBetweenChecks;
  return point.residual * std::pow(rate, checks) <= goal;
}

// Stage A, from `point`: as long as they lead on, or all that are left of `most`. True at the tolerance.
bool BlockSolver::Work::sweeps(int most, bool all) {
  const double before = best.residual;
  double last = point.residual;
  while (result.sweeps < most && best.residual > options.tolerance) {
    sweep(system, point);
    system.sweep_turning(point);
    if (++result.sweeps % kBetweenChecks != 0) continue;
    system.update(point);
    note();
    rate = std::min(1.0, point.residual / last);
    if (!all && !sweeps_lead_on(most)) break;
    last = point.residual;
  }
  if (best.residual < before) result.stage = BlockResult::Stage::kSweeps;
  return best.residual <= options.tolerance;
}

// Stage B. True at the tolerance.
bool BlockSolver::Work::polish() {
  const double before = best.residual;
  const int steps = std::min(options.newton_steps, options.factors - result.factors);
  if (steps > 0) result.factors += newton.run(system, pattern(), steps, options.tolerance, best);
  if (best.residual < before) result.stage = BlockResult::Stage::kNewton;
  return best.residual <= options.tolerance;
}

// Takes away what the central path leaves of the impulses of contacts that the law opens: it is below the residual, but
// an impulse says that a contact is closed.
void BlockSolver::Work::clear_open() {
  for (int c = 0; c < system.contacts(); ++c) {
    const BlockContact& law = system.contact(c);
    Vec3& lambda = best.lambda[c];
    if (is_box(law) || law.lower > 0.0 || lambda[0] == 0.0) continue;
    const Vec3 w = system.velocity(c, best.v);
    const double slip = has_friction(law) ? law.mu * std::hypot(w[1], w[2]) : 0.0, g = system.matrix(c).largest;
    if (project_impulse(law, lambda - (w + Vec3(slip, 0.0, 0.0)) / g).isZero(0.0)) lambda.setZero();
  }
  system.update(best);
  best.residual = system.residual(best);
}

// Stage C, with B after it.
void BlockSolver::Work::interior_point() {
  const double before = best.residual;
  result.factors += interior.run(system, pattern(), nullptr, options.accept, options.factors - result.factors, best);
  if (best.residual < before) {
    result.stage = BlockResult::Stage::kInteriorPoint;
    clear_open();
  }
  if (best.residual > options.tolerance) polish();
}

// The sweeps that did not lead on, where nothing else has: slowly they go where other methods stay at the boundary.
void BlockSolver::Work::last_sweeps() {
  point = best;
  if (!sweeps(options.sweeps, true)) polish();
}

// Stage D on `best`.
void BlockSolver::Work::repair() {
  result.factors += normals.run(system, pattern(), kRepairTolerance, kNormalIterations, best);
  best.residual = system.residual(best);
  result.stage = BlockResult::Stage::kRepaired;
}

// An answer whose energy is below the bound, or as low as it can be had: the law without slip, which dissipates, or
// contacts without friction.
void BlockSolver::Work::find_safe(double bound) {
  if (!system.bounded() && system.turning_points().empty()) {
    no_slip.assign(system.contacts(), 0.0);
    safe = best;
    safe.residual = std::numeric_limits<double>::infinity();
    result.factors += interior.run(system, pattern(), &no_slip, kSafeTolerance, kConvexIterations, safe);
    if (gaps_kept(safe) && within(system.energy(safe.v), bound)) return;
  }
  safe.lambda.assign(system.contacts(), Vec3::Zero());
  result.factors += normals.run(system, pattern(), kRepairTolerance, kNormalIterations, safe);
}

// Stage E: the point between the safe answer and `best`, as near to the latter as the energy allows. Cone, gaps and
// energy are convex conditions: every point between keeps what both ends keep.
void BlockSolver::Work::blend(double bound) {
  find_safe(bound);
  const double safe_energy = system.energy(safe.v);
  bound = std::max(bound, safe_energy);
  VecX& d = point.v;
  d = best.v - safe.v;
  double share = largest_share(system.product(d, safe.v), 0.5 * system.product(d, d), bound - safe_energy);
  if (within(system.energy(best.v), bound)) share = 1.0;
  // Where not all gaps can be kept, those of the safe answer decide.
  const bool kept = system.worst_gap(best.v) >= system.worst_gap(safe.v) - options.accept * system.scale();
  if (!kept || !std::isfinite(share)) share = 0.0;
  if (share >= 1.0) return;
  for (int k = 0; k < system.contacts(); ++k)
    best.lambda[k] = safe.lambda[k] + share * (best.lambda[k] - safe.lambda[k]);
  system.update(best);
  best.residual = system.residual(best);
  result.stage = BlockResult::Stage::kBlended;
  result.blend = share;
}

void BlockSolver::Work::finish(VecRef lambda, VecRef v) {
  for (int c = 0; c < system.contacts(); ++c)
    for (int r = 0; r < system.contact(c).rows; ++r) lambda[system.contact(c).row + r] = best.lambda[c][r];
  v = best.v;
  result.residual = best.residual;
  result.violation = -system.worst_gap(best.v);
  result.energy = system.energy(best.v);
  if (lambda.allFinite() && v.allFinite() && std::isfinite(result.energy)) return;
  result.stage = BlockResult::Stage::kFailed;
}

void BlockSolver::prepare(const BlockProblem& problem) {
  work_->analysed = false;
  work_->prepared = work_->system.prepare(problem);
}

BlockResult BlockSolver::solve(const BlockProblem& problem, double bound, const BlockOptions& options, VecRef lambda,
                               VecRef v) {
  Work& work = *work_;
  if (!work.start(problem, lambda)) {
    lambda.setZero();
    return work.result;
  }
  work.options = options;
  const auto accepted = [&] { return work.best.residual <= options.accept; };
  work.begin();
  // Of points with turning friction the cone is none of second order: the interior point method has no such pairs.
  const bool conic = work.system.turning_points().empty();
  if (!work.sweeps(std::min(kSweepsFirst, options.sweeps)) && !work.polish() && work.sweeps_lead_on(options.sweeps)) {
    work.point = work.best;
    if (!work.sweeps(options.sweeps)) work.polish();
  }
  if (!accepted() && conic) work.interior_point();
  // Without that method Newton's starts again from ever more sweeps.
  for (int k = 0; k < (conic ? 1 : kTurningRounds) && !accepted(); ++k, work.options.sweeps *= 2) work.last_sweeps();
  // Where the law is not met but cone, gaps and energy are as they should be, the answer stays: new normal impulses
  // would only be further from the law.
  if (!work.gaps_kept(work.best)) work.repair();
  const double energy = work.system.energy(work.best.v);
  if (!work.within(energy, bound) || !work.gaps_kept(work.best)) work.blend(bound);
  work.finish(lambda, v);
  return work.result;
}

void BlockSolver::free_velocity(const BlockProblem& problem, VecCRef lambda, VecCRef v, VecRef v_free) const {
  VecX& free = work_->free;
  free = v;
  for (int c = 0; work_->prepared && c < static_cast<int>(problem.contacts.size()); ++c) {
    const BlockContact& law = problem.contacts[c];
    Vec3 impulse = Vec3::Zero();
    impulse.head(law.rows) = lambda.segment(law.row, law.rows);
    if (!impulse.isZero(0.0)) work_->system.push(c, -impulse, free);
  }
  v_free = free;
}

BlockResult BlockSolver::solve_normals(const BlockProblem& problem, double tolerance, VecRef lambda, VecRef v) {
  Work& work = *work_;
  if (!work.start(problem, lambda)) {
    lambda.setZero();
    return work.result;
  }
  std::swap(work.best, work.point);
  work.result.factors = work.normals.run(work.system, work.pattern(), tolerance, kNormalIterations, work.best);
  work.best.residual = work.normals.residual();
  work.result.stage = BlockResult::Stage::kRepaired;
  work.finish(lambda, v);
  return work.result;
}

}  // namespace contactvi

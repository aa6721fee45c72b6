#include "cone/block_normals.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/tolerances.hpp"
#include "cone/turning_law.hpp"

namespace contactvi {

namespace {

constexpr int kNormalSweeps = 12;  // tried first, as long as they halve the residual in kNormalBetweenChecks
constexpr int kNormalBetweenChecks = 3;
constexpr int kNewtonSteps = 6, kPolishSteps = 3;
constexpr int kSweepsAfter = 3;        // a Newton step
constexpr int kNormalStalled = 3;      // steps that do not halve the residual, until the next method
constexpr double kNormalShift = 1e-8;  // of the natural map's derivative, as in block_newton.cpp
constexpr double kNormalBoundary = 0.995, kNormalLeastCentering = 1e-6;
constexpr double kNearPath = 1e-2;  // start of the interior point, of the scale of speeds
constexpr double kNearEnd = 1e-5;   // residual from which it is interrupted for Newton steps
constexpr int kStalledPath = 5;     // its iterations that do not halve the residual
constexpr double kHalved = 0.5;
// Compliance of a gap, a share of the contact's own mobility: keeps the weights finite. The second is for problems
// whose gaps cannot all be kept (offset < 0): impulses grow to violation over compliance.
constexpr double kRigid = 1e-11, kSoft = 1e-6;
constexpr double kOpen = 1e-6;     // of the scale: a gap that is not kept
constexpr double kNoWorse = 1.01;  // between gaps that are not kept
// A cone whose edge is kept in spite of rounding.
constexpr double kNormalInside = 1.0 + 4.0 * std::numeric_limits<double>::epsilon();

}  // namespace

void BlockNormals::begin(const BlockSystem& system, ConePoint& point) {
  const int m = system.contacts();
  low_.assign(m, 0.0);
  pairs_.resize(m);
  weight_.resize(m);
  K_.assign(m, Mat3::Zero());
  for (int c = 0; c < m; ++c) {
    const BlockContact& law = system.contact(c);
    Vec3& lambda = point.lambda[c];
    if (!has_gap(law)) continue;
    if (!has_friction(law)) lambda.tail<2>().setZero();
    low_[c] = law.lower;
    if (law.turning >= 0)
      low_[c] = std::max(law.lower, least_normal(law.mu, lambda, point.lambda[law.turning]) * kNormalInside);
    else if (has_friction(law))
      low_[c] = std::max(law.lower, lambda.tail<2>().norm() / law.mu * kNormalInside);
    lambda[0] = std::max(lambda[0], low_[c]);
  }
  system.update(point);
  best_residual_ = std::numeric_limits<double>::infinity();
}

double BlockNormals::evaluate(const BlockSystem& system, const ConePoint& point) const {
  double worst = 0.0;
  for (int c = 0; c < system.contacts(); ++c) {
    if (!has_gap(system.contact(c))) continue;
    const double g = system.matrix(c).G(0, 0), w = system.normal_velocity(c, point.v), n = point.lambda[c][0];
    const double error = std::abs(std::min(w, (n - low_[c]) * g));
    if (!(error <= worst)) worst = error;
  }
  return worst / system.scale();
}

bool BlockNormals::keep(const BlockSystem& system, const ConePoint& point) {
  const double residual = evaluate(system, point);
  if (!(residual < best_residual_)) return false;
  best_residual_ = residual;
  best_.lambda = point.lambda;
  best_.v = point.v;
  return true;
}

void BlockNormals::sweep(const BlockSystem& system, ConePoint& point) const {
  for (int c = 0; c < system.contacts(); ++c) {
    if (!has_gap(system.contact(c))) continue;
    const double w = system.normal_velocity(c, point.v), before = point.lambda[c][0];
    const double after = std::max(low_[c], before - w / system.matrix(c).G(0, 0));
    if (after == before) continue;
    system.push_normal(c, after - before, point.v);
    point.lambda[c][0] = after;
  }
}

// Closed contacts (lambda_n - w_n/g > low) get w_n = 0, the others lambda_n = low.
bool BlockNormals::newton_step(const BlockSystem& system, BlockFactor& factor, ConePoint& point) {
  step_.setZero(system.dofs());
  for (int c = 0; c < system.contacts(); ++c) {
    K_[c](0, 0) = 0.0;
    if (!has_gap(system.contact(c))) continue;
    const double g = system.matrix(c).G(0, 0), w = system.normal_velocity(c, point.v), n = point.lambda[c][0];
    const bool closed = n - w / g > low_[c];
    weight_[c] = K_[c](0, 0) = closed ? 1.0 / (kNormalShift * g) : 0.0;
    pairs_[c].d = closed ? -w * weight_[c] : low_[c] - n;
    system.pull(c, Vec3(pairs_[c].d, 0.0, 0.0), step_);
  }
  if (!factor.factor(system.problem(), K_, true) || !factor.solve(step_)) return false;
  for (int c = 0; c < system.contacts(); ++c)
    if (has_gap(system.contact(c))) point.lambda[c][0] += pairs_[c].d - weight_[c] * system.normal_speed(c, step_);
  // Bounds that the step has left are met at once: they hold at every point that is kept.
  for (int c = 0; c < system.contacts(); ++c)
    if (has_gap(system.contact(c))) point.lambda[c][0] = std::max(point.lambda[c][0], low_[c]);
  system.update(point);
  return true;
}

int BlockNormals::newton(const BlockSystem& system, BlockFactor& factor, double tolerance, int steps,
                         ConePoint& point) {
  int used = 0, stalled = 0;
  while (used < steps && best_residual_ > tolerance && stalled < kNormalStalled) {
    ++used;
    if (!newton_step(system, factor, point)) break;
    const double before = best_residual_;
    keep(system, point);
    // Redundant contacts whose gaps disagree: sweeps sort out which of them carry.
    for (int k = 0; k < kSweepsAfter && best_residual_ > tolerance; ++k) sweep(system, point);
    system.update(point);
    keep(system, point);
    stalled = best_residual_ < kHalved * before ? 0 : stalled + 1;
  }
  return used;
}

double BlockNormals::direction(const BlockSystem& system, BlockFactor& factor, double target, bool corrected) {
  step_.setZero(system.dofs());
  for (int c = 0; c < system.contacts(); ++c) {
    if (!has_gap(system.contact(c))) continue;
    Pair& p = pairs_[c];
    // n ds + s dn = right, ds = W dv + compliance dn + error: dn = d - weight W dv
    const double right = target - p.n * p.s - (corrected ? p.corrector : 0.0);
    p.d = weight_[c] * (right / p.n - p.error);
    system.pull(c, Vec3(p.d, 0.0, 0.0), step_);
  }
  if (!factor.solve(step_)) return -1.0;
  double share = std::numeric_limits<double>::infinity();
  for (int c = 0; c < system.contacts(); ++c) {
    if (!has_gap(system.contact(c))) continue;
    Pair& p = pairs_[c];
    p.dn = p.d - weight_[c] * system.normal_speed(c, step_);
    const double right = target - p.n * p.s - (corrected ? p.corrector : 0.0);
    p.ds = (right - p.s * p.dn) / p.n;
    if (p.dn < 0.0) share = std::min(share, -p.n / p.dn);
    if (p.ds < 0.0) share = std::min(share, -p.s / p.ds);
  }
  return share;
}

bool BlockNormals::advance(const BlockSystem& system, BlockFactor& factor, double compliance) {
  mean_ = 0.0;
  int count = 0;
  for (int c = 0; c < system.contacts(); ++c) {
    K_[c](0, 0) = 0.0;
    if (!has_gap(system.contact(c))) continue;
    Pair& p = pairs_[c];
    const double soft = compliance * system.matrix(c).G(0, 0);
    ++count;
    mean_ += p.n * p.s;
    p.error = system.normal_velocity(c, trial_.v) + soft * p.n - p.s;
    weight_[c] = K_[c](0, 0) = 1.0 / (p.s / p.n + soft);
  }
  mean_ /= std::max(count, 1);
  if (!factor.factor(system.problem(), K_, true)) return false;
  const double predicted = std::min(1.0, direction(system, factor, 0.0, false));
  if (!(predicted >= 0.0)) return false;
  for (Pair& p : pairs_) p.corrector = p.dn * p.ds;
  const double centering = std::max(std::pow(1.0 - predicted, 3), kNormalLeastCentering);
  const double share = direction(system, factor, centering * mean_, true);
  if (!(share >= 0.0)) return false;
  const double length = std::min(1.0, kNormalBoundary * share);
  for (int c = 0; c < system.contacts(); ++c) {
    if (!has_gap(system.contact(c))) continue;
    Pair& p = pairs_[c];
    p.n = std::max(p.n + length * p.dn, kLeastDivisor);
    p.s = std::max(p.s + length * p.ds, kLeastDivisor);
    trial_.lambda[c][0] = low_[c] + p.n;
  }
  system.update(trial_);
  return true;
}

// From the best point to the central path above it.
void BlockNormals::start_path(const BlockSystem& system, double tolerance) {
  trial_.lambda = best_.lambda;
  trial_.v = best_.v;
  const double start = std::max(kNearPath, std::sqrt(tolerance)) * system.scale();
  for (int c = 0; c < system.contacts(); ++c) {
    if (!has_gap(system.contact(c))) continue;
    const double g = system.matrix(c).G(0, 0), t = start / g;
    const double x = trial_.lambda[c][0] - low_[c] - system.normal_velocity(c, trial_.v) / g;
    const double larger = 0.5 * (std::abs(x) + std::sqrt(x * x + 4.0 * t * t)), smaller = t * t / larger;
    pairs_[c].n = x > 0.0 ? larger : smaller;
    pairs_[c].s = g * (x > 0.0 ? smaller : larger);
    trial_.lambda[c][0] = low_[c] + pairs_[c].n;
  }
  system.update(trial_);
}

// Along the path to a residual `goal`; stops when the gaps are in and the rest no longer halves.
int BlockNormals::follow_path(const BlockSystem& system, BlockFactor& factor, double goal, double compliance,
                              int iterations) {
  int used = 0;
  double least = std::numeric_limits<double>::infinity();
  for (int stalled = 0; used < iterations;) {
    ++used;
    if (!advance(system, factor, compliance)) break;
    keep(system, trial_);
    const double residual = evaluate(system, trial_);
    stalled = residual < kHalved * least ? 0 : stalled + 1;
    least = std::min(least, residual);
    if (residual <= goal || (stalled >= kStalledPath && -system.worst_gap(trial_.v) <= goal * system.scale())) break;
  }
  return used;
}

int BlockNormals::run(const BlockSystem& system, BlockFactor& factor, double tolerance, int iterations,
                      ConePoint& point) {
  begin(system, point);
  keep(system, point);
  double last = best_residual_;
  for (int k = 1; k <= kNormalSweeps && best_residual_ > tolerance; ++k) {
    sweep(system, point);
    if (k % kNormalBetweenChecks != 0) continue;
    system.update(point);
    keep(system, point);
    if (best_residual_ > kHalved * last) break;
    last = best_residual_;
  }
  point.lambda = best_.lambda;
  point.v = best_.v;
  int used = newton(system, factor, tolerance, std::min(kNewtonSteps, iterations), point);
  if (best_residual_ > tolerance) start_path(system, tolerance);
  // Contacts that touch without load make the end of the path slow: Newton steps know by then who carries.
  int left = iterations;
  for (const double goal : {std::max(kNearEnd, tolerance), tolerance}) {
    if (best_residual_ <= tolerance || left <= 0) break;
    const int along = follow_path(system, factor, goal, kRigid, left);
    left -= along;
    point.lambda = best_.lambda;
    point.v = best_.v;
    used += along + newton(system, factor, tolerance, kPolishSteps, point);
  }
  point.lambda = best_.lambda;
  point.v = best_.v;
  if (-system.worst_gap(point.v) > kOpen * system.scale()) used += soften(system, factor, tolerance, iterations, point);
  return used;
}

// Gaps that cannot all be kept, or were not: the answer with a small compliance, from impulses as low as they can be,
// unless its gaps are worse. point: the best so far, then the better of the two.
int BlockNormals::soften(const BlockSystem& system, BlockFactor& factor, double tolerance, int iterations,
                         ConePoint& point) {
  const double residual = best_residual_;
  best_residual_ = std::numeric_limits<double>::infinity();
  for (int c = 0; c < system.contacts(); ++c)
    if (has_gap(system.contact(c))) best_.lambda[c][0] = low_[c];
  system.update(best_);
  start_path(system, tolerance);
  const int used = follow_path(system, factor, tolerance, kSoft, iterations);
  if (system.worst_gap(best_.v) >= kNoWorse * system.worst_gap(point.v)) {
    point.lambda = best_.lambda;
    point.v = best_.v;
  } else {
    best_residual_ = residual;
  }
  return used;
}

}  // namespace contactvi

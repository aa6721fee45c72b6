#include "cone/solver.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "cone/projected_sweeps.hpp"
#include "cone/single_contact.hpp"
#include "cone/sweep.hpp"

namespace contactvi {

namespace {

// Newton steps at most: in general, without shift, and from the last solution.
constexpr int kIterations = 40, kIterationsPlain = 20, kIterationsWarm = 12;
constexpr double kDisagree = 1e-3;  // residual up to which the direct solution of an immobile contact is accepted
// Of the interior point method, from which Newton's method starts again where it stalled: its iterations at most,
// and the residual at which it ends (of the largest free speed).
constexpr int kPathIterations = 60;
constexpr double kPathEnd = 1e-10;
constexpr int kSweeps = 100;  // of Gauss-Seidel, for where that stalls, too
// Starts of Newton's method from projected sweeps, and how many of these each has more than the one before.
constexpr int kProjectedStarts = 12, kProjectedSweeps = 50;

bool turns(const ConeProblem& problem) {
  return std::any_of(problem.contacts.begin(), problem.contacts.end(), [](const ConeContact& c) { return c.rows > 3; });
}

// Cuts an impulse of friction of so many rows to its bound, where it is beyond by more than rounding.
void cut(double* x, int rows, double most) {
  double sum = 0.0;
  for (int k = 0; k < rows; ++k) sum += x[k] * x[k];
  const double friction = std::sqrt(sum);
  if (friction <= most * (1.0 + kConeTolerance)) return;
  for (int k = 0; k < rows; ++k) x[k] *= most / friction;
}

}  // namespace

void ConeSolver::reserve(int rows) {
  map_.reserve(rows);
  newton_.reserve(rows);
  system_.reserve(rows);
  factor_.reserve(rows);
  if (static_cast<int>(start_.size()) >= rows) return;
  for (auto* v : {&start_, &best_, &w_, &shift_}) v->resize(rows);
}

bool ConeSolver::one_contact(const ConeProblem& problem, double* lambda) {
  const ConeContact& c = problem.contacts.front();
  Mat3 A = Mat3::Zero();
  Vec3 b = Vec3::Zero(), found;
  for (int k = 0; k < c.rows; ++k) {
    b[k] = problem.b[k];
    for (int j = 0; j < c.rows; ++j) A(k, j) = problem.G(k, j);
  }
  bool immobile = false;
  if (!solve_one_contact(c, A, b, found, problem.noise, problem.rough, &immobile)) return false;
  std::copy_n(found.data(), c.rows, lambda);
  map_.velocity(problem, lambda, w_.data());
  map_.evaluate(problem, lambda, w_.data());
  result_.residual = map_.residual();
  // Rows of a singular matrix that disagree have no better solution, but for huge impulses.
  return result_.residual <= (immobile && problem.rough > 0.0 ? kDisagree : kConeTolerance);
}

// Finds the unique solution with the shift. From a start far from it Newton's method is slow, since the impulses that
// redundant contacts share move w by eps only: then it starts from zero, over larger shifts.
bool ConeSolver::shifted(const ConeProblem& problem, double* lambda) {
  using Singular = ConeNewton::Singular;
  map_.set_shift(1.0);
  if (newton_.run(problem, map_, Singular::kMinimumNorm, kIterationsWarm, lambda)) return true;
  std::fill_n(lambda, problem.b.size(), 0.0);
  for (double times : {1e3, 30.0, 1.0}) {
    map_.set_shift(times);
    newton_.run(problem, map_, Singular::kMinimumNorm, kIterations, lambda);
  }
  return newton_.residual() <= kConeTolerance;
}

// Newton's method with G alone, where that has one solution. Redundant contacts show in a singular matrix, or in a
// contact that touches without load.
bool ConeSolver::plain(const ConeProblem& problem, double* lambda) {
  map_.set_shift(0.0);
  return newton_.run(problem, map_, ConeNewton::Singular::kStop, kIterationsPlain, lambda) && !newton_.singular() &&
         !map_.touching();
}

bool ConeSolver::attempt(const ConeProblem& problem, bool regularize, double* lambda) {
  const int m = static_cast<int>(problem.b.size());
  if (regularize) {
    std::copy_n(lambda, m, start_.data());
    if (plain(problem, lambda)) return true;
    std::copy_n(start_.data(), m, lambda);
    if (shifted(problem, lambda)) {
      std::copy_n(lambda, m, shift_.data());
      shifted_ = m;
    }
  }
  map_.set_shift(0.0);
  using Singular = ConeNewton::Singular;
  return newton_.run(problem, map_, regularize ? Singular::kLeastImpulses : Singular::kMinimumNorm, kIterations,
                     lambda);
}

// Keeps lambda in best_ and the result if its residual is smaller; true if that is a solution.
bool ConeSolver::keep_better(double* lambda, int rows) {
  if (newton_.residual() < result_.residual) {
    result_.residual = newton_.residual();
    std::copy_n(lambda, rows, best_.data());
  }
  return result_.residual <= kConeTolerance;
}

// Newton's method from where ever more projected sweeps lead, with spinning or rolling friction.
bool ConeSolver::rescue_turning(const ConeProblem& problem, bool regularize, double* lambda) {
  using Singular = ConeNewton::Singular;
  const int m = static_cast<int>(problem.b.size());
  std::fill_n(start_.data(), m, 0.0);
  map_.set_shift(0.0);
  for (int k = 1; k <= kProjectedStarts; ++k) {
    projected_sweeps(problem, map_, k * kProjectedSweeps, start_.data());
    std::copy_n(start_.data(), m, lambda);
    ++result_.fallbacks;
    newton_.run(problem, map_, regularize ? Singular::kLeastImpulses : Singular::kMinimumNorm, kIterations, lambda);
    if (keep_better(lambda, m)) return true;
  }
  return false;
}

// Newton's method from where an interior point method leads, and from where sweeps do.
bool ConeSolver::rescue(const ConeProblem& problem, bool regularize, double* lambda) {
  using Singular = ConeNewton::Singular;
  const int m = static_cast<int>(problem.b.size());
  if (turns(problem)) return rescue_turning(problem, regularize, lambda);
  const auto polished = [&] {
    ++result_.fallbacks;
    system_.write(point_, lambda);
    map_.set_shift(0.0);
    newton_.run(problem, map_, regularize ? Singular::kLeastImpulses : Singular::kMinimumNorm, kIterations, lambda);
    return keep_better(lambda, m);
  };
  system_.start(problem);
  system_.read(best_.data(), point_);
  system_.project(point_);
  point_.residual = system_.residual(point_);
  interior_.run(system_, factor_, nullptr, kPathEnd, kPathIterations, point_);
  if (polished()) return true;
  for (Vec3& impulse : point_.lambda) impulse.setZero();
  system_.project(point_);
  for (int k = 0; k < kSweeps; ++k) sweep(system_, point_);
  return polished();
}

// Takes away what Newton's method leaves of the impulses of contacts that the law opens: it is less than the solution
// is accurate to, but an impulse says that a contact is closed.
void ConeSolver::clear_open(const ConeProblem& problem, double* lambda) const {
  for (std::size_t i = 0; i < problem.contacts.size(); ++i) {
    const ConeContact& c = problem.contacts[i];
    if (c.box > 0.0 || map_.mode(static_cast<int>(i)).closed) continue;
    lambda[c.row] = c.lower;
    if (c.lower <= 0.0) std::fill_n(lambda + c.row + 1, c.rows - 1, 0.0);
  }
}

// What Newton's method leaves of the law, as much as the noise of the velocities where it is solved, is better left in
// the velocities than outside of the friction cones.
void ConeSolver::keep_in_cones(const ConeProblem& problem, double* lambda) {
  for (const ConeContact& c : problem.contacts) {
    double* x = lambda + c.row;
    if (c.box > 0.0) {
      x[0] = std::clamp(x[0], -c.box, c.box);
      continue;
    }
    x[0] = std::max(x[0], c.lower);
    if (c.rows == 1) continue;
    cut(x + 1, c.friction_rows(), c.mu * x[0]);
    if (c.rolling > 0.0) cut(x + c.rolling_row(), 2, c.rolling * x[0]);
  }
}

ConeResult ConeSolver::solve(const ConeProblem& problem, VecRef lambda, bool regularize) {
  const int m = static_cast<int>(problem.b.size());
  result_ = ConeResult();
  reserve(m);
  newton_.reset();
  if (regularize) newton_.forget();
  shifted_ = 0;
  if (lambda.size() != m || !map_.prepare(problem)) {
    lambda.setZero();
    result_.residual = std::numeric_limits<double>::infinity();
    return result_;
  }
  if (!lambda.allFinite()) lambda.setZero();
  result_.ok = m == 0 || (problem.contacts.size() == 1 && problem.contacts.front().rows <= 3 &&
                          one_contact(problem, lambda.data()));
  if (!result_.ok) {
    result_.residual = std::numeric_limits<double>::infinity();
    std::fill_n(best_.data(), m, 0.0);
    attempt(problem, regularize, lambda.data());
    if (newton_.residual() <= kConeTolerance) clear_open(problem, lambda.data());
    result_.ok = keep_better(lambda.data(), m);
    if (!(result_.residual <= std::max(problem.accept, kConeTolerance)))
      result_.ok = rescue(problem, regularize, lambda.data());
    std::copy_n(best_.data(), m, lambda.data());
    keep_in_cones(problem, lambda.data());
  }
  for (int k = 0; k < shifted_; ++k) shift_[k] -= lambda[k];
  result_.iterations = newton_.iterations();
  result_.factors = newton_.factors();
  return result_;
}

}  // namespace contactvi

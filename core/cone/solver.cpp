#include "cone/solver.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "cone/single_contact.hpp"

namespace contactvi {

namespace {

// Newton steps at most: in general, without shift, and from the last solution.
constexpr int kIterations = 40, kIterationsPlain = 20, kIterationsWarm = 12;
constexpr double kDisagree = 1e-3;  // residual up to which the direct solution of an immobile contact is accepted
// Gauss-Seidel sweeps at most: for a start after a failure, and for one within plain().
constexpr int kSeidelSweeps = 200, kFewSweeps = 30;

}  // namespace

void ConeSolver::reserve(int rows) {
  map_.reserve(rows);
  newton_.reserve(rows);
  fallback_.reserve(rows);
  if (static_cast<int>(start_.size()) >= rows) return;
  for (auto* v : {&start_, &best_, &w_}) v->resize(rows);
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
  for (bool after_seidel : {false, true}) {
    if (after_seidel) {
      ++result_.fallbacks;
      std::fill_n(lambda, problem.b.size(), 0.0);
      fallback_.gauss_seidel(problem, map_, kFewSweeps, lambda);
    }
    if (newton_.run(problem, map_, ConeNewton::Singular::kStop, after_seidel ? kIterations : kIterationsPlain, lambda))
      return !newton_.singular() && !map_.touching();
    if (newton_.singular()) return false;
  }
  return false;
}

bool ConeSolver::attempt(const ConeProblem& problem, bool regularize, double* lambda) {
  const int m = static_cast<int>(problem.b.size());
  if (regularize) {
    std::copy_n(lambda, m, start_.data());
    if (plain(problem, lambda)) return true;
    std::copy_n(start_.data(), m, lambda);
    shifted(problem, lambda);
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

bool ConeSolver::may_rescue(const ConeProblem& problem) {
  // A contact that goes on slipping in a given direction may have no solution (Painleve's paradox): the caller frees it.
  for (const ConeContact& c : problem.contacts)
    if (c.frozen && c.rows == 3) return false;
  const int rows = static_cast<int>(problem.b.size());
  if (rows <= kFew) return true;
  const double square = static_cast<double>(rows) * rows;
  if (square > rescues_left_) {
    gave_up_ = true;
    return false;
  }
  rescues_left_ -= square;
  return true;
}

bool ConeSolver::rescue(const ConeProblem& problem, bool regularize, double* lambda) {
  const int m = static_cast<int>(problem.b.size());
  for (bool shift : {true, false}) {
    if (shift && !regularize) continue;
    for (bool by_seidel : {true, false}) {
      ++result_.fallbacks;
      map_.set_shift(shift ? 1.0 : 0.0);
      std::fill_n(lambda, m, 0.0);
      if (by_seidel)
        fallback_.gauss_seidel(problem, map_, kSeidelSweeps, lambda);
      else
        fallback_.admm(problem, map_, lambda);
      if (shift) newton_.run(problem, map_, ConeNewton::Singular::kMinimumNorm, kIterations, lambda);
      map_.set_shift(0.0);
      newton_.run(problem, map_, shift ? ConeNewton::Singular::kLeastImpulses : ConeNewton::Singular::kMinimumNorm,
                  kIterations, lambda);
      if (keep_better(lambda, m)) return true;
    }
  }
  return false;
}

// Takes away what Newton's method leaves of the impulses of contacts that the law opens: it is less than the solution
// is accurate to, but an impulse says that a contact is closed.
void ConeSolver::clear_open(const ConeProblem& problem, double* lambda) const {
  for (std::size_t i = 0; i < problem.contacts.size(); ++i) {
    const ConeContact& c = problem.contacts[i];
    if (c.box > 0.0 || map_.mode(static_cast<int>(i)).closed) continue;
    lambda[c.row] = c.lower;
    if (c.lower <= 0.0 && c.rows == 3) lambda[c.row + 1] = lambda[c.row + 2] = 0.0;
  }
}

// What Newton's method leaves of the law is better left in the velocities than outside of the friction cones.
void ConeSolver::keep_in_cones(const ConeProblem& problem, double* lambda) {
  for (const ConeContact& c : problem.contacts) {
    double* x = lambda + c.row;
    if (c.box > 0.0) {
      x[0] = std::clamp(x[0], -c.box, c.box);
      continue;
    }
    x[0] = std::max(x[0], c.lower);
    if (c.rows == 1) continue;
    const double friction = std::sqrt(x[1] * x[1] + x[2] * x[2]), most = c.mu * x[0];
    if (friction <= most) continue;
    x[1] *= most / friction;
    x[2] *= most / friction;
  }
}

ConeResult ConeSolver::solve(const ConeProblem& problem, VecRef lambda, bool regularize) {
  const int m = static_cast<int>(problem.b.size());
  result_ = ConeResult();
  reserve(m);
  newton_.reset();
  if (lambda.size() != m || !map_.prepare(problem)) {
    lambda.setZero();
    result_.residual = std::numeric_limits<double>::infinity();
    return result_;
  }
  if (!lambda.allFinite()) lambda.setZero();
  result_.ok = m == 0 || (problem.contacts.size() == 1 && one_contact(problem, lambda.data()));
  if (!result_.ok) {
    result_.residual = std::numeric_limits<double>::infinity();
    std::fill_n(best_.data(), m, 0.0);
    attempt(problem, regularize, lambda.data());
    if (newton_.residual() <= kConeTolerance) clear_open(problem, lambda.data());
    result_.ok = keep_better(lambda.data(), m);
    if (!(result_.residual <= std::max(problem.accept, kConeTolerance)) && may_rescue(problem))
      result_.ok = rescue(problem, regularize, lambda.data());
    std::copy_n(best_.data(), m, lambda.data());
    if (!result_.ok) keep_in_cones(problem, lambda.data());
  }
  result_.iterations = newton_.iterations();
  return result_;
}

}  // namespace contactvi

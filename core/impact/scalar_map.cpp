#include "impact/scalar_map.hpp"

#include <cmath>

#include "impact/ctec.hpp"

namespace contactvi {

namespace {
constexpr double kExact = 8e-16;  // of the energies that add up to the scalar: its equation is solved to rounding
constexpr double kAcceptedEnergy = 1e-12;  // of the kinetic energy of the normal motion
constexpr double kFar = 0.5;               // of the start impulse: a root farther from it belongs to a grazing impact
constexpr int kMaxIterations = 30;
}  // namespace

ImpactResult ScalarMap::apply(const ImpactProblem& problem, VecRef p) const {
  const ImpactResult ctec = explicit_impulse(problem, p);
  return ctec.ok ? correct(problem, ctec, p) : ctec;
}

// What is left of the equation: the scalar after the impact less its target and the work of prescribed motions in it.
double ScalarMap::balance(const ImpactProblem& problem, const VecX& p_plus, double impulse) const {
  return scalar(problem, p_plus) - problem.target + impulse * problem.offset;
}

ImpactResult ScalarMap::correct(const ImpactProblem& problem, const ImpactResult& start, VecRef p) const {
  ImpactResult result = start;
  auto fall_back = [&](Fallback reason) {
    result.impulse = start.impulse;
    result.fallback = reason;
    const VecX p_start = problem.p_minus + start.impulse * problem.W;
    const double left = balance(problem, p_start, start.impulse);
    result.jump = std::isfinite(left) ? left : 0.0;
    p = p_start;
    return result;
  };
  if (problem.restitution == 0.0) return fall_back(Fallback::kPlastic);
  const double normal_energy = 0.5 * problem.gamma_minus * problem.gamma_minus / problem.G_c;
  const double exact =
      kExact * (std::abs(problem.target) + problem.p_minus.dot(problem.MinvW) / problem.G_c * problem.gamma_minus);
  const double slope = problem.gamma_minus + start.impulse * problem.G_c;  // gamma+ of the start: dH/dlambda
  VecX p_plus(p.size());
  double lambda = start.impulse, previous_lambda = 0.0, previous = 0.0, best = INFINITY, best_lambda = lambda;
  for (int k = 0; k < kMaxIterations; ++k) {
    p_plus = problem.p_minus + lambda * problem.W;
    const double mismatch = balance(problem, p_plus, lambda);
    ++result.iterations;
    if (!std::isfinite(mismatch)) break;
    if (std::abs(mismatch) < best) {
      best = std::abs(mismatch);
      best_lambda = lambda;
    } else if (best <= kAcceptedEnergy * normal_energy) {
      break;  // rounding floor
    }
    if (std::abs(mismatch) <= exact) break;
    const double secant = k == 0 ? slope : (mismatch - previous) / (lambda - previous_lambda);
    const double change = -mismatch / secant;
    if (!std::isfinite(change)) break;
    if (std::abs(lambda + change - start.impulse) > kFar * start.impulse) return fall_back(Fallback::kGrazing);
    if (lambda + change == lambda) break;
    previous_lambda = lambda;
    previous = mismatch;
    lambda += change;
  }
  if (!(best <= kAcceptedEnergy * normal_energy || best <= 16 * exact)) return fall_back(Fallback::kNoConvergence);
  const double gamma_plus = problem.gamma_minus + best_lambda * problem.G_c;
  // With e < 1 a root that separates faster than the approach is an error of the step, not one of the impact.
  const bool gains = problem.restitution < 1.0 && gamma_plus > -problem.gamma_minus;
  if (best_lambda < 0.0 || gamma_plus <= 0.0 || gains) return fall_back(Fallback::kInadmissible);
  result.impulse = best_lambda;
  result.jump = best;
  p = problem.p_minus + best_lambda * problem.W;
  return result;
}

}  // namespace contactvi

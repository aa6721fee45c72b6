#include "contact/dense_energy.hpp"

#include <algorithm>
#include <cmath>

#include "base/root.hpp"

namespace contactvi {

double kinetic_share(const BlockProblem& problem, const VecX& from, const VecX& to, double bound) {
  double start = 0.0, slope = 0.0, square = 0.0;
  for (int b = 0; b < problem.blocks(); ++b) {
    const int n = problem.size(b), first = problem.start[b];
    const VecX v = from.segment(first, n), d = to.segment(first, n) - v;
    start += 0.5 * problem.M.product(b, v, v);
    slope += problem.M.product(b, v, d);
    square += 0.5 * problem.M.product(b, d, d);
  }
  if (start + slope + square <= bound || !(square > 0.0)) return 1.0;
  return largest_share(slope, square, std::max(0.0, bound - start));
}

double curvature_error(const BlockProblem& problem, const VecX& change, const VecX& last) {
  double error = 0.0;
  for (int b = 0; b < problem.blocks(); ++b) {
    const int n = problem.size(b), first = problem.start[b];
    const VecX d = change.segment(first, n);
    error += std::abs(problem.M.product(b, d, d - last.segment(first, n)));
  }
  return 0.5 * error;
}

double turning_error(const Tree& tree, const VecX& v, double h, const Energy& before, const Energy& free,
                     const Energy& middle) {
  const double turn = largest_turn(tree, v, h);
  return turn * turn / 12.0 * (std::abs(middle.potential - before.potential) + std::abs(free.kinetic - before.kinetic));
}

}  // namespace contactvi

// Solver of the Coulomb cone problem (problem.hpp).
#pragma once

#include <vector>

#include "cone/dense_system.hpp"
#include "cone/interior_point.hpp"
#include "cone/natural_map.hpp"
#include "cone/newton.hpp"
#include "cone/problem.hpp"

namespace contactvi {

// Solves one contact directly, more by Newton's method on the natural map, and where that stalls again from where an
// interior point method leads, then from where Gauss-Seidel sweeps do; with spinning or rolling friction from where
// projected sweeps do. Where the forces are not unique (four corners
// on a plane) the solution is
//   regularize       near the one of least norm, whatever the start: G + eps I first, then minimum-norm Newton steps;
//   not regularize   the one that minimum-norm Newton steps reach from the start.
// Among several solutions that differ in their velocities none is preferred; the same input gives the same output.
class ConeSolver {
 public:
  // Makes room: problems of at most so many rows allocate nothing in solve().
  void reserve(int rows);
  // lambda: start on entry, solution on return (m,) [N s]; finite also if the result is not ok. Problems that follow
  // without `regularize` have nearly the same matrix as the one before: its factors are tried first.
  ConeResult solve(const ConeProblem& problem, VecRef lambda, bool regularize);
  // With `regularize`: by what the impulses with the shift, which are unique, differ from those of the last problem
  // (m,); empty where that had one solution without it. Which contacts carry something, and which of them slip, is
  // plain there, and rounding where impulses are least: a problem like it is best started from the sum of both.
  Eigen::Map<const VecX> shift() const { return {shift_.data(), shifted_}; }

 private:
  bool one_contact(const ConeProblem& problem, double* lambda);
  bool plain(const ConeProblem& problem, double* lambda);
  bool shifted(const ConeProblem& problem, double* lambda);
  bool attempt(const ConeProblem& problem, bool regularize, double* lambda);
  bool rescue_turning(const ConeProblem& problem, bool regularize, double* lambda);
  bool rescue(const ConeProblem& problem, bool regularize, double* lambda);
  void clear_open(const ConeProblem& problem, double* lambda) const;
  static void keep_in_cones(const ConeProblem& problem, double* lambda);
  bool keep_better(double* lambda, int rows);

  NaturalMap map_;
  ConeNewton newton_;
  DenseSystem system_;
  DenseFactor factor_;
  InteriorPoint<DenseSystem, DenseFactor> interior_;
  ConePoint point_;
  ConeResult result_;
  std::vector<double> start_, best_, w_, shift_;
  int shifted_ = 0;  // rows that shift() has
};

}  // namespace contactvi

// Solver of the Coulomb cone problem (problem.hpp).
#pragma once

#include <limits>
#include <vector>

#include "cone/fallback.hpp"
#include "cone/natural_map.hpp"
#include "cone/newton.hpp"
#include "cone/problem.hpp"

namespace contactvi {

// Solves one contact directly, more by Newton's method on the natural map, and where that stalls from better starts:
// Gauss-Seidel sweeps, then ADMM. Where the forces are not unique (four corners on a plane) the solution is
//   regularize       near the one of least norm, whatever the start: G + eps I first, then minimum-norm Newton steps;
//   not regularize   the one that minimum-norm Newton steps reach from the start.
// Among several solutions that differ in their velocities none is preferred; the same input gives the same output.
class ConeSolver {
 public:
  // Makes room: problems of at most so many rows allocate nothing in solve().
  void reserve(int rows);
  // lambda: start on entry, solution on return (m,) [N s]; finite also if the result is not ok.
  ConeResult solve(const ConeProblem& problem, VecRef lambda, bool regularize);
  // Where Newton's method fails other starts are tried, which cost a hundred times as much. In problems of more than
  // kFew rows they are, from now on, tried for as long as the sum of the squares of the rows stays within this.
  static constexpr int kFew = 12;
  void allow_rescues(double squares) {
    rescues_left_ = squares;
    gave_up_ = false;
  }
  // Whether a problem was given up for that reason since then.
  bool gave_up() const { return gave_up_; }

 private:
  bool one_contact(const ConeProblem& problem, double* lambda);
  bool plain(const ConeProblem& problem, double* lambda);
  bool shifted(const ConeProblem& problem, double* lambda);
  bool attempt(const ConeProblem& problem, bool regularize, double* lambda);
  bool may_rescue(const ConeProblem& problem);
  bool rescue(const ConeProblem& problem, bool regularize, double* lambda);
  void clear_open(const ConeProblem& problem, double* lambda) const;
  static void keep_in_cones(const ConeProblem& problem, double* lambda);
  bool keep_better(double* lambda, int rows);

  NaturalMap map_;
  ConeNewton newton_;
  ConeFallback fallback_;
  ConeResult result_;
  std::vector<double> start_, best_, w_;
  double rescues_left_ = std::numeric_limits<double>::infinity();
  bool gave_up_ = false;
};

}  // namespace contactvi

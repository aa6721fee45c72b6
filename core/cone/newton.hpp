// Semismooth Newton on the natural map of the cone problem.
#pragma once

#include <vector>

#include "base/small_linear.hpp"
#include "cone/natural_map.hpp"

namespace contactvi {

class ConeNewton {
 public:
  // What to do where the linearised law has no unique solution (redundant contacts): stop; take the step of least norm;
  // or let the first step, if nothing slips, go to the impulses of least norm. The last drops what lambda has in the
  // null space, which is errors of b over the shift; with slip the shift selects impulses that are not those of least
  // norm, and they are kept.
  enum class Singular { kStop, kMinimumNorm, kLeastImpulses };

  void reserve(int rows);
  // Newton steps with line search from lambda until the residual is a few rounding errors or no step lowers the merit
  // below the largest of the last four (the natural map has kinks: a merit that has to fall in each step falls ever
  // more slowly). lambda: best on return. map: prepared, with or without shift. True if the residual is <=
  // kConeTolerance.
  bool run(const ConeProblem& problem, NaturalMap& map, Singular singular, int max_iterations, double* lambda);

  double residual() const { return residual_; }
  int iterations() const { return iterations_; }  // of all runs since reset()
  int factors() const { return factors_; }        // of them those with a new factor
  void reset() { iterations_ = factors_ = 0; }
  // Until forget() is called problems follow each other whose matrices are nearly the same: a step whose unknowns are
  // those of the last factor is tried with it.
  void forget() { factor_ = Factor::kNone; }
  bool singular() const { return singular_; }  // a singular matrix ended the last run (kStop)

 private:
  // One unknown of a step, delta, and the equation that belongs to it: lambda changes by column * delta in `rows` rows
  // of its contact from `row` on, the equation is test . w + diagonal * delta = right side with three rows from there.
  struct Unknown {
    int contact, row, rows;
    double column[6], test[3];
    double diagonal;
    int single;  // the only row that is tested, by 1; -1: there are more
    // Row and part of the law as one number: rows is 1 to 6, single -1 to 2.
    int kind() const { return 32 * row + 4 * rows + 1 + single; }
  };
  // Friction of one kind in a step: its rows begin at `row`, and a unit of the normal impulse has this much of it.
  struct Ball {
    int contact, row;
    TangentMode mode;
    const Vec3* e;
    double beta, scale, mu;
    const double* d;
  };

  // How the last matrix was factored, for which shift, and its unknowns.
  enum class Factor { kNone, kRegular, kSingular };

  static double tested(const Unknown& u, const double* w);
  bool same_unknowns() const;
  void add_step();
  void remember_unknowns(const NaturalMap& map);
  void right_side();
  template <int N>
  void add_ball(const Ball& ball, double normal, const double* old, double* x, double* ray);
  void build(const ConeProblem& problem, const NaturalMap& map, const double* lambda, bool from_nothing);
  void assemble(const ConeProblem& problem, const NaturalMap& map);
  bool solve(const ConeProblem& problem, const NaturalMap& map, Singular singular);
  void solve_again();
  void take_back(const ConeProblem& problem, NaturalMap& map, double* lambda);
  bool search(const ConeProblem& problem, NaturalMap& map, double* lambda);

  SmallLinear linear_;
  std::vector<Unknown> unknowns_;
  int count_ = 0;
  std::vector<double> w_, next_, next_w_, trial_, trial_w_;  // velocity at lambda; at the step's end; of a trial
  std::vector<double> product_, delta_, weight_;
  static constexpr int kMemory = 4;
  double past_[kMemory] = {};  // merits of the last points
  int visited_ = 0;            // points of this run
  double residual_ = 0.0;
  int iterations_ = 0, factors_ = 0;
  Factor factor_ = Factor::kNone;
  double factor_shift_ = 0.0;
  std::vector<int> factor_unknowns_;
  int factor_count_ = 0;
  bool singular_ = false;
};

}  // namespace contactvi

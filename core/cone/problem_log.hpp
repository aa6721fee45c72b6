// The contact problems that steps pose, as they are given to the solvers: for tests and benchmarks of these.
#pragma once

#include <utility>
#include <vector>

#include "cone/block_problem.hpp"
#include "cone/problem.hpp"

namespace contactvi {

class ProblemLog {
 public:
  // Of a dense step. Equations: W_e^T v = W_e^T v_free, (nv, m).
  struct Blocks {
    BlockProblem problem;
    MatX equations;
    VecX start;  // impulses from which the solver starts (rows,)
    double bound;
  };
  // Of a contact step. The first rows of G and b are those of `equations` constraints, which have no cones.
  struct Rows {
    std::vector<ConeContact> contacts;
    MatX G;
    VecX b, start;
    int equations;
    double noise;
  };

  void add(Blocks problem) { blocks_.push_back(std::move(problem)); }
  void add(Rows problem) { rows_.push_back(std::move(problem)); }
  std::vector<Blocks> take_blocks() { return std::exchange(blocks_, {}); }
  std::vector<Rows> take_rows() { return std::exchange(rows_, {}); }

 private:
  std::vector<Blocks> blocks_;
  std::vector<Rows> rows_;
};

}  // namespace contactvi

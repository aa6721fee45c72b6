// The contact problem of many bodies, kept sparse: a block per static tree (a free body, a robot), and contacts that
// act on one or two of them.
//
//   v = v_free + M^-1 W lambda,   w = W^T v + offset       M: one block per tree; W: columns of the contacts' rows
//   normal      lambda_n >= lower, w_n >= 0, (lambda_n - lower) w_n = 0
//   tangential  |lambda_t| <= mu lambda_n; w_t != 0 => lambda_t = -mu lambda_n w_t/|w_t|     (maximal dissipation)
//   box         one row, |lambda| <= box; w != 0 => lambda = -box sign(w)                    (friction of a joint)
//   turning     rows (spin, roll1, roll2) of a point with friction: the spin is a third component of its tangential
//               law; |lambda_roll| <= lambda_n with maximal dissipation
//
// The laws are those of problem.hpp, which keeps the matrix G = W^T M^-1 W dense.
#pragma once

#include <Eigen/Cholesky>
#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

struct BlockContact {
  int a = -1, b = -1;  // the blocks that the contact acts on, a >= 0; b = -1: only one
  int row = 0;         // first row
  int rows = 3;        // 3: n, t1, t2; 1: normal alone, or joint friction
  int column = 0;      // where its rows' coefficients begin in BlockProblem::W: rows x size(a), then rows x size(b)
  double mu = 0.0, lower = 0.0, box = 0.0;  // box > 0: joint friction
  // Friction of a point against spinning and rolling is an entry of its own, on the same blocks, with three rows; those
  // of what the point lacks are zero. turning: that entry of a point; of: the point of that entry; -1: none.
  int turning = -1, of = -1;
};

// The masses of the blocks, symmetric positive definite [kg; kg m; kg m^2], and their inverses C C^T. Masses and
// factors are made of the inverses when they are first asked for: many problems are solved without.
class BlockMasses {
 public:
  int count() const { return static_cast<int>(blocks_.size()); }
  void resize(int blocks) { blocks_.resize(blocks); }
  void set_inverse(int block, const Eigen::Ref<const MatX>& inverse);
  // Not a number if the masses are not positive.
  void set(int block, const Eigen::Ref<const MatX>& masses);
  void copy(int block, const BlockMasses& other, int from);
  const MatX& inverse(int block) const { return blocks_[block].inverse; }
  const MatX& operator[](int block) const;
  const Eigen::LLT<MatX>& factor(int block) const;  // C
  bool positive(int block) const;
  // x.M y of vectors of one block [J].
  double product(int block, const VecCRef& x, const VecCRef& y) const;

 private:
  struct Block {
    MatX inverse, masses;
    Eigen::LLT<MatX> factor;
    bool has_masses = false, has_factor = false;
  };
  mutable std::vector<Block> blocks_;
};

struct BlockProblem {
  std::vector<int> start;  // (blocks + 1,): first degree of freedom of each block; the last one is nv
  BlockMasses M;
  std::vector<BlockContact> contacts;  // their rows follow each other without gaps
  std::vector<double> W;               // coefficients of the rows, row after row (BlockContact::column)
  VecX v_free;                         // (nv,) [m/s; rad/s]
  VecX offset;                         // (rows,) [m/s]

  int blocks() const { return static_cast<int>(start.size()) - 1; }
  int size(int block) const { return start[block + 1] - start[block]; }
  int rows() const { return static_cast<int>(offset.size()); }
};

// Velocity of row r of a contact, without its offset.
inline double row_velocity(const BlockProblem& problem, const BlockContact& c, int r, const VecX& v) {
  const int size_a = problem.size(c.a), size_b = c.b >= 0 ? problem.size(c.b) : 0;
  double w = 0.0;
  const double* a = problem.W.data() + c.column + r * size_a;
  for (int d = 0; d < size_a; ++d) w += a[d] * v[problem.start[c.a] + d];
  const double* b = problem.W.data() + c.column + c.rows * size_a + r * size_b;
  for (int d = 0; d < size_b; ++d) w += b[d] * v[problem.start[c.b] + d];
  return w;
}

}  // namespace contactvi

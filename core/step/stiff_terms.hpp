// Derivatives of the elements' forces in the Newton matrix of a step, as a change of low rank.
//
// The kernel solves with D, the mass matrix and what is diagonal beside it. With a stiff spring between two bodies the
// step's matrix is D + J C J^T, and by Woodbury's formula
//   (D + J C J^T)^-1 r = x - Z (1 + C J^T Z)^-1 C J^T x,   x = D^-1 r,  Z = D^-1 J.
#pragma once

#include <Eigen/LU>
#include <vector>

#include "step/stages.hpp"

namespace contactvi {

class StiffTerms {
 public:
  StiffTerms(const Tree& tree, const Stages& stages);

  bool any() const { return columns_ > 0; }
  // Evaluates the terms at the stages; the kernel's factor must be that of the step.
  void factor(Stages& stages, const VecCRef& q0);
  // After an iteration of the kernel: changes its correction, in dv and v, to that of the whole matrix.
  void correct(Stages& stages);
  // Changes dv = D^-1 r of the stages to the step's inverse matrix, or its transpose, times r; nothing else changes.
  void correct_solution(Stages& stages, bool transposed);
  // Changes X = D^-1 Y, of a single stage, to the step's inverse matrix times Y.
  void correct(Eigen::Ref<MatX> X) const;

 private:
  struct Terms {
    MatX J, C, Z, small;
    int used = 0;  // columns that are not all zero; small and lu are of these
    auto Jt() const { return J.leftCols(used).transpose(); }
    auto factors() const { return C.topLeftCorner(used, used); }
    Eigen::PartialPivLU<MatX> lu;  // of 1 + C J^T Z
  };
  const Tree* tree_;
  int columns_;
  bool active_ = false;
  std::vector<Terms> at_;  // per stage
  VecX q_, v_, x_;
  std::vector<double> kept_;
};

}  // namespace contactvi

// Anderson acceleration of iterations that contract slowly (Walker, Ni, "Anderson acceleration for fixed-point
// iterations", SIAM J. Numer. Anal. 49, 2011), in the energy norm: <f, g> = f^T M g, which is f^T r with the residual
// r = M g that a correction g was solved from.
#pragma once

#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

class AndersonAcceleration {
 public:
  void clear() { count_ = 0; }
  // After an iteration: x (n,), the corrected unknowns, are replaced by the accelerated ones. f: the correction, r: the
  // residual that it was solved from, both (m,); m < n where the energy is one of the first unknowns alone.
  void apply(VecX& x, const VecX& f, const VecX& r);

 private:
  static constexpr int kDepth = 8;
  struct Iteration {
    VecX x, f, r;  // the newest as they are, older ones as differences to their successors
  };
  void push(const VecX& x, const VecX& f, const VecX& r);
  int weigh(int columns, double* gamma) const;

  std::vector<Iteration> history_;  // newest first; empty until first used
  int count_ = 0;
};

}  // namespace contactvi

// Anderson acceleration of stage iterations that contract slowly (Walker, Ni, "Anderson acceleration for fixed-point
// iterations", SIAM J. Numer. Anal. 49, 2011), in the energy norm: <f, g> = f^T M g, which is f^T r with the residual
// r = M g that a correction g was solved from.
#pragma once

#include <vector>

#include "step/stages.hpp"

namespace contactvi {

class AndersonAcceleration {
 public:
  AndersonAcceleration(int nv, const Stages& stages);
  void clear() { count_ = 0; }
  // After an iteration: v holds the corrected velocities, which are replaced by the accelerated ones.
  void apply(Stages& stages);

 private:
  static constexpr int kDepth = 8;
  struct Iteration {
    AlignedArray v, f, r;  // the newest as they are, older ones as differences to their successors
  };
  void push(const Stages& stages);
  int weigh(int columns, double* gamma) const;
  double dot(const AlignedArray& a, const AlignedArray& b) const;

  int nv_, s_, S_;
  std::vector<Iteration> history_;  // newest first; empty until first used
  int count_ = 0;
};

}  // namespace contactvi

// The nodes between and beside the s Gauss stages of a step at which impulses act: the Lobatto nodes
// 0 = d_0 < d_1 < ... < d_s = 1, the zeros of the derivative of the Legendre polynomial P_s and both ends.
//
// Jay, "Specialized partitioned additive Runge-Kutta methods for systems of overdetermined DAEs with holonomic
// constraints", SIAM J. Numer. Anal. 45 (2007): an impulse at node k adds the share 1 - to_node[k][i] / b_i of itself
// to the momentum of stage i, which makes the step symplectic.
#pragma once

#include "base/gauss.hpp"

namespace contactvi {

struct LobattoTable {
  int s;
  double d[kMaxStages + 1];
  double e[kMaxStages + 1];                    // weights
  double to_node[kMaxStages + 1][kMaxStages];  // integral of the j-th Lagrange polynomial of the stages over [0, d_k]
  double share[kMaxStages][kMaxStages + 1];    // [i][k]: of an impulse at node k in the momentum of stage i
};

// The table that belongs to s Gauss stages, s in 1 .. kMaxStages.
const LobattoTable& lobatto_table(int s);

}  // namespace contactvi

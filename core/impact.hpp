// What every impact map is given and gives back. A map is one file: impact_ctec.cpp, ...
//
//   p+ = p- + lambda W^T, lambda >= 0;  gamma = W M^-1 p;  G_c = W M^-1 W^T.
#pragma once

#include "tree_lu.hpp"

namespace contactvi {

struct ImpactProblem {
  const TreeLu& mass;  // M(q_c), factored
  const VecX& W;       // gap gradient at q_c, (nv,)
  const VecX& MinvW;   // M^-1 W^T, (nv,)
  double gamma_minus;  // < 0
  double G_c;
  double restitution;  // in [0, 1]
};

struct ImpactResult {
  bool ok = false;
  double impulse = 0;  // lambda
  double gamma_plus = 0;
  int iterations = 0;
};

}  // namespace contactvi

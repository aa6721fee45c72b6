// The velocity of the only stage of a step of order 2: q1 = q0 (+) h v.
#pragma once

#include "model/tree.hpp"

namespace contactvi {

// Adds to the gradients in q0, q1 and h what they have by that in v, which follows from them.
void fold_velocity(const Tree& tree, double h, const VecX& v, const VecX& lv, VecX& lq0, VecX& lq1, double& lh);

}  // namespace contactvi

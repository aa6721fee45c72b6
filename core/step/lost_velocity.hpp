// How much of a velocity is lost when it becomes a momentum and a velocity again: rounding where the mass matrix is
// good, all of it where a motion has no inertia.
#pragma once

#include "step/step_equations.hpp"

namespace contactvi {

struct LostVelocity {
  int dof = 0;         // of the public coordinates that loses most
  double share = 0.0;  // of a velocity of size one; NaN where there is none
};

// At q (nq,). Uses the node of these equations.
LostVelocity lost_velocity(StepEquations& equations, const VecX& q);

}  // namespace contactvi

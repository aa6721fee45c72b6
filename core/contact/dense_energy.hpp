// The energy of a dense step: how much of an expansion it allows, and by how much the step may be wrong about it.
#pragma once

#include "cone/block_problem.hpp"
#include "model/tree.hpp"
#include "step/energy.hpp"

namespace contactvi {

// The largest share of the way from the velocities `from` to `to` with which the kinetic energy stays within the bound
// [J], or is as low as it can be. The energy is a convex function on the way.
double kinetic_share(const BlockProblem& problem, const VecX& from, const VecX& to, double bound);

// Of a step without impacts inside of it: the energy that it conserves differs from H by terms of the order h^2, which
// change with the acceleration. change, last: of the velocity in this step, and in the last one over the same length.
// The factor is that of the modified Hamiltonian, h^2 a M a/24 + ..., with room for its other terms [J].
double curvature_error(const BlockProblem& problem, const VecX& change, const VecX& last);

// Of bodies that turn with the velocities v over the step h: (h omega)^2/12 of the changes of T and V [J]. free: at the
// end of the step without contacts, middle: at its end before the velocity impulse.
double turning_error(const Tree& tree, const VecX& v, double h, const Energy& before, const Energy& free,
                     const Energy& middle);

}  // namespace contactvi

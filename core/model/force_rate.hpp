// How forces change with time where the motion stands still: those of wrenches and functions that users give.
#pragma once

#include "model/elements.hpp"
#include "model/forces.hpp"

namespace contactvi {

// Whether a force may depend on time explicitly.
bool forces_depend_on_time(const Elements& e);

// The derivative by time of all forces of a field at (t, q, v), (nv,). They are known by their values alone, so by
// differences of fourth order, and not after t, nor longer before it than `before` [s], as a run may begin or end
// there: over .4 ms at most, by which it is off by 1e-8 of a rate that swings with 100 rad/s. scale: of the forces that
// act. Throws NoDerivative where they jump.
void force_rate(ForceField& field, double t, double before, const VecCRef& q, const VecCRef& v, double scale,
                VecRef rate);

}  // namespace contactvi

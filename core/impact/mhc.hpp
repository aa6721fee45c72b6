// MHC, the modified-Hamiltonian conserving impact map: the modified Hamiltonian, which the integrator really
// conserves, has the same value at the end of the step with the impact as before, less the loss (Pekarek, Murphey
// 2014, "Discrete Lagrangian mechanics for nonseparable nonsmooth systems"; Murphey, Pekarek, Seghete). At order 4
// and more that is H.
#pragma once

#include "impact/scalar_map.hpp"

namespace contactvi {

// p becomes p+, shape (nv,). problem.target: the reference ("local": its value at the start of the step, "global":
// the one carried from the start of the run) less all losses since.
ImpactResult impact_mhc(const ImpactProblem& problem, VecRef p);
// The same beside another impulse than CTEC's, that of an impact with friction or several points: p_minus + impulse W
// is what it leads to, and only its size is changed.
ImpactResult impact_mhc(const ImpactProblem& problem, const ImpactResult& ctec, VecRef p);

}  // namespace contactvi

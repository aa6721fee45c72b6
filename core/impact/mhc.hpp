// MHC, the modified-Hamiltonian conserving impact map: the modified Hamiltonian, which the integrator really
// conserves, has the same value at the end of the step with the impact as before, less the loss (Pekarek, Murphey
// 2014, "Discrete Lagrangian mechanics for nonseparable nonsmooth systems"; Murphey, Pekarek, Seghete). At order 4
// and more that is H. "Before" is the start of the step or of the run (MhcReference).
#pragma once

#include "impact/impact_law.hpp"

namespace contactvi {

const ImpactLaw& mhc_law();

}  // namespace contactvi

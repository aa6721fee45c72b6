// A smooth step of any order that kept rows, as it was taken, with all that its derivative needs. Engine coordinates.
#pragma once

#include "step/integrator.hpp"

namespace contactvi {

struct HeldStepRecord {
  double t, h;  // start and length [s]
  VecX q0, p0, v1;
  MatX rates;   // of the charts at its stages, (nv, s)
  MatX lambda;  // impulses of its rows at its nodes, (rows, s + 1)
};

// The step from (q0, p0) that was just solved.
inline HeldStepRecord held_step_record(Integrator& solved, const VecX& q0, const VecX& p0) {
  const StageConstraints& rows = *solved.constraints();
  return {solved.time(), solved.length(), q0, p0, rows.end_velocity(), solved.rates(), rows.node_impulses()};
}

}  // namespace contactvi

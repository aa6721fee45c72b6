// Directions of a run, and its columns: what changes along them on the way.
#pragma once

#include <vector>

#include "step/step_parameters.hpp"

namespace contactvi {

// Directions, one per column; an empty matrix: none of them changes it. Public coordinates.
struct RunDirections {
  Eigen::Index count = 0;
  MatX q, v;                               // of the start: tangent vectors and velocities, (nv, count)
  MatX tau;                                // of the inputs of all steps, (nv, count)
  MatX inputs;                             // of the inputs step by step, of a single direction, (steps, nv)
  MatX e, mu;                              // of restitution and friction, (guards, count)
  std::vector<StepParameters> parameters;  // one per column

  const StepParameters* parameter(Eigen::Index k) const { return parameters.empty() ? nullptr : &parameters[k]; }
};

// Along each direction: the change of the state, engine coordinates, and of the time where the present piece starts.
struct RunColumns {
  MatX q, p;  // (nv, count)
  VecX time;  // (count,) [s]

  // The state is taken so much later along each direction; fq, fp: its derivative by time, (nv,).
  void move_on(const VecX& later, const VecX& fq, const VecX& fp) {
    q += fq * later.transpose();
    p += fp * later.transpose();
    time = later;
  }
};

}  // namespace contactvi

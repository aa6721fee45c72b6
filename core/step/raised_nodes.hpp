// The path of a step at its Lobatto nodes as a linear function of the rates at its stages, and, where it is raised by
// the velocities at both ends (path.hpp), of the rates there.
#pragma once

#include "base/lobatto.hpp"
#include "base/numerics.hpp"

namespace contactvi {

struct RaisedNodes {
  explicit RaisedNodes(int stages);

  // Column k is node k + 1: the rate of the stages' polynomial there (stages, stages); that of the path raised, by the
  // rates at the stages (stages, stages) and at both ends (stages,).
  MatX plain, rate;
  VecX rate_by_start, rate_by_end;
  // Displacement of the path raised, over h, in the same way.
  MatX moved;
  VecX moved_by_start, moved_by_end;
};

}  // namespace contactvi

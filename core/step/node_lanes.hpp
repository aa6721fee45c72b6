// Velocities of many states of one tree, as many at a time as the kernel has lanes: v = M(q)^-1 p with the digits of
// StepEquations::node_velocity.
#pragma once

#include <memory>
#include <vector>

#include "step/stage_lanes.hpp"

namespace contactvi {

class NodeLanes {
 public:
  explicit NodeLanes(const Tree& tree);

  // Replaces momenta by velocities; states in columns, engine coordinates. Where M is not positive they become NaN.
  void velocities(const Eigen::Ref<const MatX>& q, Eigen::Ref<MatX> p);

 private:
  FlatModel model_;
  StageLanes lanes_;
  std::vector<std::unique_ptr<Stages>> nodes_;  // by lane
  std::vector<Stages*> used_;
};

}  // namespace contactvi

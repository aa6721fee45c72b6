// Velocities v = M(q)^-1 p of several states of one tree in the lanes of the kernel, with the digits of
// StepEquations::node_velocity. Engine coordinates.
#pragma once

#include <memory>
#include <vector>

#include "step/stage_lanes.hpp"

namespace contactvi {

// A state, as the kernel takes it: before and after StageLanes::solve_masses.
void put_node(const VecCRef& q, const VecCRef& p, Stages& node);
bool get_velocity(const Stages& node, const VecCRef& p, VecRef v);  // false if M is not positive

// Of many states, as many at a time as there are lanes.
class NodeLanes {
 public:
  explicit NodeLanes(const Tree& tree);
  // Replaces momenta by velocities; states in columns. Where M is not positive they become NaN.
  void find_velocities(const Eigen::Ref<const MatX>& q, Eigen::Ref<MatX> p);

 private:
  const Tree* tree_;
  FlatModel model_;
  StageLanes lanes_;
  std::vector<std::unique_ptr<Stages>> nodes_;  // by lane, as many as were needed so far
  std::vector<Stages*> used_;
};

// Runs that are made side by side, as one of them sees them that asks for a velocity.
class NodeCompany {
 public:
  virtual ~NodeCompany() = default;
  virtual StageLanes& node_lanes_of(const FlatModel& model) = 0;
  // dv <- M^-1 dv of a node, together with those of other runs. False, and nothing is done, where no other one asks.
  virtual bool solve_masses(Stages& node, StageLanes& lanes) = 0;
};

}  // namespace contactvi

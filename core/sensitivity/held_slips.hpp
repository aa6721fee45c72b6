// The slips of a held step at the nodes between both ends, of the path that the velocities at both ends raise
// (step/raised_nodes.hpp). Across their directions they are zero, and the coefficients of friction are those of them.
#pragma once

#include "sensitivity/held_node.hpp"
#include "step/raised_nodes.hpp"

namespace contactvi {

class HeldSlips {
 public:
  HeldSlips(const Tree& tree, int stages);

  // Takes a step with its nodes, which are to stay alive; v0: velocity at its start. False where a slip turns back
  // within the step.
  bool take(const HeldStepRecord& step, std::vector<HeldNode>& nodes, const VecX& v0);
  // What the equations of the numbers of the slips (held_node.hpp) are off by over the step, (numbers,), at node k,
  // where the rates at the stages change by du, the velocities at both ends by dv0 and dv1, the displacements of the
  // nodes by dX, (nv, nodes), the start by dq0, the length by dh, the time of the node by dt, and the numbers there.
  VecX change(int k, const MatX& du, const VecX& dv0, const VecX& dv1, const MatX& dX, const VecX& dq0, double dh,
              double dt, const VecX& numbers) const;
  // From their gradients, (numbers (stages - 1),), to those in the velocities at the start and at the end.
  VecX start_gradient(const VecX& l) const { return gradient(raised_.rate_by_start, raised_.moved_by_start, l); }
  VecX end_gradient(const VecX& l) const;

 private:
  VecX gradient(const VecX& rate_share, const VecX& moved_share, const VecX& l) const;
  const HeldNode& node(int k) const { return (*nodes_)[static_cast<std::size_t>(k)]; }
  MatX watched(int k) const { return node(k).watched().rightCols(node(k).numbers()).transpose(); }

  RaisedNodes raised_;
  std::vector<NodeChart> charts_;  // of the nodes between
  const HeldStepRecord* record_ = nullptr;
  const std::vector<HeldNode>* nodes_ = nullptr;
  VecX end_rate_;
  MatX rates_, X_;
  // Of the equations: by the number of each, by the time, (numbers, stages), and by the configuration.
  MatX own_, by_t_;
  std::vector<MatX> turned_by_;
};

}  // namespace contactvi

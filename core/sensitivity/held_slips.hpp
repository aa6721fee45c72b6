// The slips of a held step at the nodes between both ends, of the path that the velocities at both ends raise
// (step/raised_nodes.hpp). Across their directions they are zero.
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
  // What the slips across change by over the step, (slides,), at node k, where the rates at the stages change by du,
  // the velocities at both ends by dv0 and dv1, the displacements of the nodes by dX, (nv, nodes), the start by dq0,
  // the length by dh, and the direction at the node by turned.
  VecX change(int k, const MatX& du, const VecX& dv0, const VecX& dv1, const MatX& dX, const VecX& dq0, double dh,
              const VecX& turned) const;
  // From their gradients, (slides (stages - 1),), to those in the velocities at the start and at the end.
  VecX start_gradient(const VecX& l) const { return gradient(raised_.rate_by_start, raised_.moved_by_start, l); }
  VecX end_gradient(const VecX& l) const;

 private:
  VecX gradient(const VecX& rate_share, const VecX& moved_share, const VecX& l) const;
  const HeldNode& node(int k) const { return (*nodes_)[static_cast<std::size_t>(k)]; }
  MatX across(int k) const { return node(k).watched().rightCols(node(k).along().cols()).transpose(); }

  RaisedNodes raised_;
  std::vector<NodeChart> charts_;  // of the nodes between
  const HeldStepRecord* record_ = nullptr;
  const std::vector<HeldNode>* nodes_ = nullptr;
  VecX end_rate_;
  MatX rates_, X_, slips_;       // and the slips along their directions
  std::vector<MatX> turned_by_;  // of the slips across, by the configuration
};

}  // namespace contactvi

#include "step/node_lanes.hpp"
#include "model/coupling.hpp"

#include <algorithm>
#include <limits>

namespace contactvi {

void put_node(const VecCRef& q, const VecCRef& p, Stages& node) {
  node.at(q);
  for (Eigen::Index d = 0; d < p.size(); ++d) node.dv()[d] = p[d];
}

bool get_velocity(const Stages& node, const VecCRef& momentum, VecRef v) {
  VecX p = momentum;
  fold_momentum(node.tree(), p);  // as StepEquations::node_velocity
  double energy = 0.0;
  for (Eigen::Index d = 0; d < p.size(); ++d) {
    const double speed = node.dv()[d];
    energy += speed * p[d];
    v[d] = speed;  // which may stand in the place of the momentum
  }
  return energy >= 0.0;  // false for NaN
}

NodeLanes::NodeLanes(const Tree& tree) : tree_(&tree), model_(tree), lanes_(model_) {}

void NodeLanes::find_velocities(const Eigen::Ref<const MatX>& q, Eigen::Ref<MatX> p) {
  const Eigen::Index most = StageLanes::most_runs();
  for (Eigen::Index first = 0; first < q.cols(); first += most) {
    const Eigen::Index count = std::min(most, q.cols() - first);
    used_.clear();
    for (Eigen::Index lane = 0; lane < count; ++lane) {
      if (lane == static_cast<Eigen::Index>(nodes_.size()))
        nodes_.push_back(std::make_unique<Stages>(*tree_, model_, 1));
      put_node(q.col(first + lane), p.col(first + lane), *nodes_[lane]);
      used_.push_back(nodes_[lane].get());
    }
    lanes_.solve_masses(used_);
    for (Eigen::Index lane = 0; lane < count; ++lane) {
      auto v = p.col(first + lane);
      if (!get_velocity(*used_[lane], v, v)) v.setConstant(std::numeric_limits<double>::quiet_NaN());
    }
  }
}

}  // namespace contactvi

#include "step/node_lanes.hpp"

#include <algorithm>
#include <limits>

#include "model/coupling.hpp"

namespace contactvi {

void put_node(const VecCRef& q, const VecCRef& p, Stages& node) {
  node.at(q);
  for (Eigen::Index d = 0; d < p.size(); ++d) node.dv()[d] = p[d];
}

bool get_velocity(const Stages& node, const VecCRef& p, VecRef v) {
  if (!node.tree().followers.empty()) {
    // Not with what acts between coupled joints, whose rounding may be more than the energy.
    VecX folded = p;
    fold_momentum(node.tree(), folded);
    v = Eigen::Map<const VecX>(node.dv(), p.size());
    return v.dot(folded) >= 0.0;
  }
  double energy = 0.0;
  for (Eigen::Index d = 0; d < p.size(); ++d) {
    const double speed = node.dv()[d];
    energy += speed * p[d];
    v[d] = speed;  // which may stand in the place of p
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

#include "step/node_lanes.hpp"

#include <algorithm>
#include <limits>

namespace contactvi {

namespace {

void velocity_of(const Stages& node, VecRef p) {
  double energy = 0.0;
  for (Eigen::Index d = 0; d < p.size(); ++d) energy += node.dv()[d] * p[d];
  for (Eigen::Index d = 0; d < p.size(); ++d)
    p[d] = energy >= 0.0 ? node.dv()[d] : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace

NodeLanes::NodeLanes(const Tree& tree) : model_(tree), lanes_(model_) {
  for (int lane = 0; lane < StageLanes::most_runs(); ++lane)
    nodes_.push_back(std::make_unique<Stages>(tree, model_, 1));
}

void NodeLanes::velocities(const Eigen::Ref<const MatX>& q, Eigen::Ref<MatX> p) {
  const auto most = static_cast<Eigen::Index>(nodes_.size());
  for (Eigen::Index first = 0; first < q.cols(); first += most) {
    used_.clear();
    for (Eigen::Index k = first; k < std::min(q.cols(), first + most); ++k) {
      Stages& node = *nodes_[k - first];
      node.at(q.col(k));
      std::copy_n(p.col(k).data(), p.rows(), node.dv());
      used_.push_back(&node);
    }
    lanes_.solve_masses(used_);
    for (std::size_t lane = 0; lane < used_.size(); ++lane)
      velocity_of(*used_[lane], p.col(first + static_cast<Eigen::Index>(lane)));
  }
}

}  // namespace contactvi

// A tree of boxes, which is asked for those near a point.
#pragma once

#include <Eigen/Geometry>
#include <utility>
#include <vector>

#include "model/tree.hpp"

namespace contactvi {

// Halves of halves, each with the box around it: the boxes from `first` to before `last` are node k, their first half
// is node k + 1, and their second half comes after all nodes of the first.
class BoxTree {
 public:
  using Box = Eigen::AlignedBox3d;

  explicit BoxTree(const std::vector<Box>& boxes);

  // visit(i) for each box i that is no farther from x than a limit [m], of two halves the nearer one first. What it
  // returns is the limit from then on.
  template <class Visit>
  void near(const Vec3& x, double limit, const Visit& visit) const {
    if (!order_.empty()) descend(0, 0, order_.size(), x, limit, visit);
  }

 private:
  void build(std::size_t node, std::size_t first, std::size_t last, const std::vector<Box>& boxes);

  template <class Visit>
  void descend(std::size_t node, std::size_t first, std::size_t last, const Vec3& x, double& limit,
               const Visit& visit) const {
    if (nodes_[node].squaredExteriorDistance(x) > limit * limit) return;
    if (last - first == 1) {
      limit = visit(order_[first]);
      return;
    }
    const std::size_t middle = first + (last - first) / 2, other = node + 2 * (middle - first);
    const bool swap = nodes_[other].squaredExteriorDistance(x) < nodes_[node + 1].squaredExteriorDistance(x);
    if (swap) descend(other, middle, last, x, limit, visit);
    descend(node + 1, first, middle, x, limit, visit);
    if (!swap) descend(other, middle, last, x, limit, visit);
  }

  std::vector<Box> nodes_;
  std::vector<int> order_;
};

}  // namespace contactvi

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

  // visit(i) for each box i in a node whose box may hold what is looked for.
  template <class May, class Visit>
  void where(const May& may, const Visit& visit) const {
    if (!order_.empty()) descend({0, 0, order_.size()}, may, visit);
  }

  // visit(i, j) for each box i of this tree and box j of another one, placed at R x + t in the frame of this one, that
  // are no farther from each other than a limit [m], as seen along the axes of this one; near ones first. What it
  // returns is the limit from then on. may(k, l): whether anything in the nodes k and l of the two matters.
  template <class May, class Visit>
  void near_pairs(const BoxTree& other, const Mat3& R, const Vec3& t, double limit, const May& may,
                  const Visit& visit) const {
    if (order_.empty() || other.order_.empty()) return;
    const Node own{0, 0, order_.size()}, its{0, 0, other.order_.size()};
    descend(own, other, its, {R, R.cwiseAbs(), t}, limit, may, visit);
  }

  // The box of each node, the first one around all; and for each node, by its number, the boxes in it.
  const std::vector<Box>& nodes() const { return nodes_; }
  template <class Take>
  void each_node(const Take& take) const {
    if (!order_.empty()) each_below({0, 0, order_.size()}, take);
  }

 private:
  struct Node {
    std::size_t number, first, last;

    bool is_leaf() const { return last - first == 1; }
    Node half(bool second) const {
      const std::size_t middle = first + (last - first) / 2;
      return second ? Node{number + 2 * (middle - first), middle, last} : Node{number + 1, first, middle};
    }
  };
  struct Placed {
    Mat3 R, size;  // size: the absolute values of R
    Vec3 t;
  };

  double square_between(const Node& own, const BoxTree& other, const Node& its, const Placed& at) const {
    const Box &a = nodes_[own.number], &b = other.nodes_[its.number];
    const Vec3 apart = (at.R * b.center() + at.t - a.center()).cwiseAbs() - 0.5 * (a.sizes() + at.size * b.sizes());
    return apart.cwiseMax(0.0).squaredNorm();
  }

  template <class Take>
  void each_below(const Node& node, const Take& take) const {
    take(node.number, order_.data() + node.first, order_.data() + node.last);
    if (node.is_leaf()) return;
    each_below(node.half(false), take);
    each_below(node.half(true), take);
  }

  // The larger one of two nodes is halved.
  template <class May, class Visit>
  void descend(const Node& own, const BoxTree& other, const Node& its, const Placed& at, double& limit, const May& may,
               const Visit& visit) const {
    if (!may(own.number, its.number)) return;
    if (own.is_leaf() && its.is_leaf()) {
      if (square_between(own, other, its, at) <= limit * limit)
        limit = visit(order_[own.first], other.order_[its.first]);
      return;
    }
    const bool halves_own = its.is_leaf() || (!own.is_leaf() && nodes_[own.number].sizes().squaredNorm() >=
                                                                    other.nodes_[its.number].sizes().squaredNorm());
    Node parts[2][2];
    double square[2];
    for (int k = 0; k < 2; ++k) {
      parts[k][0] = halves_own ? own.half(k == 1) : own;
      parts[k][1] = halves_own ? its : its.half(k == 1);
      square[k] = square_between(parts[k][0], other, parts[k][1], at);
    }
    const int first = square[1] < square[0] ? 1 : 0;
    for (const int k : {first, 1 - first})
      if (square[k] <= limit * limit) descend(parts[k][0], other, parts[k][1], at, limit, may, visit);
  }

  template <class May, class Visit>
  void descend(const Node& node, const May& may, const Visit& visit) const {
    if (!may(nodes_[node.number])) return;
    if (node.is_leaf()) return visit(order_[node.first]);
    descend(node.half(false), may, visit);
    descend(node.half(true), may, visit);
  }

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

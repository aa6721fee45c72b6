// The vertices of a large hull in a tree of balls and boxes, so that those that lie farthest along a direction, or in a
// region, are found without a look at all. What is found does not depend on how convex or how flat the hull is.
#pragma once

#include <algorithm>
#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

class VertexTree {
 public:
  // No tree: for few vertices a look at all is quicker.
  VertexTree() = default;
  // Some vertices lie in a ball and in a box about one centre; the box tells where a flat side ends.
  struct Bound {
    Vec3 center, half;
    double radius;  // [m], like half more than enough for rounding
    // How far they reach along the unit vector m, at most.
    double reach(const Vec3& m) const { return m.dot(center) + std::min(radius, m.cwiseAbs().dot(half)); }
  };
  explicit VertexTree(const std::vector<Vec3>& vertices);

  bool none() const { return nodes_.empty(); }
  // The vertex farthest along the unit vector m, the first of several.
  int farthest(const Vec3& m) const;
  // Calls visit(i) for the vertices in bounds of which keeps(bound) is true when they are looked at: of two halves
  // first the one that reaches farther along m.
  template <class Keeps, class Visit>
  void each(const Vec3& m, const Keeps& keeps, const Visit& visit) const;

 private:
  struct Node {
    Bound bound;
    int first, last;  // of its vertices in numbers_
    int second;       // the node of the second half, while that of the first one follows; a leaf has none: -1
  };
  static constexpr int kDeepest = 64;  // nodes that wait while one is looked at

  void add(const std::vector<Vec3>& vertices, int first, int last);

  std::vector<Node> nodes_;
  std::vector<Vec3> points_;
  std::vector<int> numbers_;  // of points_, leaf by leaf
};

template <class Keeps, class Visit>
void VertexTree::each(const Vec3& m, const Keeps& keeps, const Visit& visit) const {
  int waiting[kDeepest], count = 0;
  waiting[count++] = 0;
  while (count > 0) {
    const int here = waiting[--count];
    const Node& node = nodes_[here];
    if (!keeps(node.bound)) continue;
    if (node.second >= 0) {
      const bool first = nodes_[here + 1].bound.reach(m) > nodes_[node.second].bound.reach(m);
      waiting[count++] = first ? node.second : here + 1;
      waiting[count++] = first ? here + 1 : node.second;
      continue;
    }
    for (int k = node.first; k < node.last; ++k) visit(numbers_[k]);
  }
}

}  // namespace contactvi

// The vertices of a large hull in a tree of balls, so that those that lie farthest along a direction, or in a region,
// are found without a look at all. What is found does not depend on how convex or how flat the hull is.
#pragma once

#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

class VertexTree {
 public:
  // No tree: for few vertices a look at all is quicker.
  VertexTree() = default;
  explicit VertexTree(const std::vector<Vec3>& vertices);

  bool none() const { return nodes_.empty(); }
  // The vertex farthest along the unit vector m, the first of several.
  int farthest(const Vec3& m) const;
  // Calls visit(i) for the vertices in balls of which keeps(center, radius) is true when they are looked at: of two
  // halves first the one that reaches farther along m.
  template <class Keeps, class Visit>
  void each(const Vec3& m, const Keeps& keeps, const Visit& visit) const;

 private:
  struct Node {
    Vec3 center;
    double radius;    // [m], more than enough for rounding
    int first, last;  // of its vertices in numbers_
    int second;       // the node of the second half, while that of the first one follows; a leaf has none: -1
  };
  static constexpr int kDeepest = 64;  // nodes that wait while one is looked at

  void add(const std::vector<Vec3>& vertices, int first, int last);

  std::vector<Node> nodes_;
  std::vector<Vec3> points_;
  std::vector<int> numbers_;  // of points_, ball by ball
};

template <class Keeps, class Visit>
void VertexTree::each(const Vec3& m, const Keeps& keeps, const Visit& visit) const {
  int waiting[kDeepest], count = 0;
  waiting[count++] = 0;
  while (count > 0) {
    const int here = waiting[--count];
    const Node& node = nodes_[here];
    if (!keeps(node.center, node.radius)) continue;
    if (node.second >= 0) {
      const Node &one = nodes_[here + 1], &two = nodes_[node.second];
      const bool first = m.dot(one.center) + one.radius > m.dot(two.center) + two.radius;
      waiting[count++] = first ? node.second : here + 1;
      waiting[count++] = first ? here + 1 : node.second;
      continue;
    }
    for (int k = node.first; k < node.last; ++k) visit(numbers_[k]);
  }
}

}  // namespace contactvi

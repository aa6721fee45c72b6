#include "geometry/vertex_tree.hpp"

#include <algorithm>
#include <limits>

namespace contactvi {

namespace {
constexpr std::size_t kFew = 64;          // vertices up to which a look at all is quicker
constexpr int kLeaf = 8;                  // vertices in one bound of the last
constexpr double kBoundRounding = 1e-12;  // of the size of a hull
}  // namespace

VertexTree::VertexTree(const std::vector<Vec3>& vertices) {
  if (vertices.size() < kFew) return;
  for (int i = 0; i < static_cast<int>(vertices.size()); ++i) numbers_.push_back(i);
  add(vertices, 0, static_cast<int>(vertices.size()));
  points_ = vertices;
  double size = 0.0;
  for (const Vec3& x : vertices) size = std::max(size, x.cwiseAbs().maxCoeff());
  for (Node& node : nodes_) {
    node.bound.radius += kBoundRounding * size;
    node.bound.half.array() += kBoundRounding * size;
  }
}

// Adds the node of these numbers_ and those below it: halves along the longest side of their box.
void VertexTree::add(const std::vector<Vec3>& vertices, int first, int last) {
  Vec3 low = vertices[numbers_[first]], high = low;
  for (int k = first; k < last; ++k) {
    low = low.cwiseMin(vertices[numbers_[k]]);
    high = high.cwiseMax(vertices[numbers_[k]]);
  }
  Node node{{0.5 * (low + high), 0.5 * (high - low), 0.0}, first, last, -1};
  Bound& bound = node.bound;
  for (int k = first; k < last; ++k)
    bound.radius = std::max(bound.radius, (vertices[numbers_[k]] - bound.center).norm());
  const std::size_t here = nodes_.size();
  nodes_.push_back(node);
  if (last - first <= kLeaf) return;
  int axis = 0;
  (high - low).maxCoeff(&axis);
  const int middle = (first + last) / 2;
  std::nth_element(numbers_.begin() + first, numbers_.begin() + middle, numbers_.begin() + last, [&](int i, int j) {
    return vertices[i][axis] < vertices[j][axis] || (vertices[i][axis] == vertices[j][axis] && i < j);
  });
  add(vertices, first, middle);
  nodes_[here].second = static_cast<int>(nodes_.size());
  add(vertices, middle, last);
}

int VertexTree::farthest(const Vec3& m) const {
  int best = -1;
  double most = -std::numeric_limits<double>::infinity();
  each(
      m, [&](const Bound& bound) { return bound.reach(m) >= most; },
      [&](int i) {
        const double along = m.dot(points_[i]);
        if (along < most || (along == most && i > best)) return;
        most = along;
        best = i;
      });
  return best;
}

}  // namespace contactvi

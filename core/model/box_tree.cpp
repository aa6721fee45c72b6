#include "model/box_tree.hpp"

#include <algorithm>
#include <numeric>

namespace contactvi {

BoxTree::BoxTree(const std::vector<Box>& boxes) : order_(boxes.size()) {
  std::iota(order_.begin(), order_.end(), 0);
  if (boxes.empty()) return;
  nodes_.resize(2 * boxes.size() - 1);
  build(0, 0, boxes.size(), boxes);
}

void BoxTree::build(std::size_t node, std::size_t first, std::size_t last, const std::vector<Box>& boxes) {
  Box& all = nodes_[node];
  for (std::size_t k = first; k < last; ++k) all.extend(boxes[static_cast<std::size_t>(order_[k])]);
  if (last - first == 1) return;
  int axis = 0;
  all.sizes().maxCoeff(&axis);
  const std::size_t middle = first + (last - first) / 2;
  const auto at = [this](std::size_t k) { return order_.begin() + static_cast<std::ptrdiff_t>(k); };
  std::nth_element(at(first), at(middle), at(last), [&](int i, int j) {
    return boxes[static_cast<std::size_t>(i)].center()[axis] < boxes[static_cast<std::size_t>(j)].center()[axis];
  });
  build(node + 1, first, middle, boxes);
  build(node + 2 * (middle - first), middle, last, boxes);
}

}  // namespace contactvi

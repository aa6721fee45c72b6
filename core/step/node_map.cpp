#include "step/node_map.hpp"

#include <algorithm>

namespace contactvi {

NodeMap::NodeMap(const Tree& tree)
    : tree_(&tree), model_(tree), pattern_(tree), local_(tree, model_, pattern_, 1), mass_(pattern_, 1), panel_(0) {}

bool NodeMap::take(const VecX& q, const VecX& v) {
  if (!tree_->followers.empty()) return false;  // the pattern is that of the tree alone
  local_.evaluate_at(q, v);
  std::copy(local_.M.low.begin(), local_.M.low.end(), mass_.low(0));
  std::copy(local_.M.up.begin(), local_.M.up.end(), mass_.up(0));
  return mass_.factor() && mass_.cancellation() <= kMostCancellation;
}

void NodeMap::to_velocities(const MatX& dq, MatX& dp) {
  const int count = static_cast<int>(dq.cols()), width = padded_width(count);
  const int components = static_cast<int>(pattern_.components().size());
  for (int component = 0; component < components; ++component) {
    const std::vector<int>& dofs = pattern_.components()[component];
    const std::size_t size = dofs.size() * width;
    if (panel_.size() < size) panel_ = AlignedArray(size);
    std::fill_n(panel_.data(), size, 0.0);
    const auto row = [&](int d) { return panel_.data() + static_cast<std::size_t>(pattern_.place(d)) * width; };
    const auto take = [&](int r, int column, double B) {
      for (int k = 0; k < count; ++k) row(r)[k] -= B * dq(column, k);
    };
    for (const int d : dofs) {
      for (int k = 0; k < count; ++k) row(d)[k] += dp(d, k);
      for (int g = 0; g <= pattern_.level(d); ++g) {
        const int a = pattern_.on_path(d, g), entry = pattern_.entry(d, g);
        take(d, a, *local_.B.row(entry));
        if (a != d) take(a, d, *local_.B.column(entry));
      }
    }
    mass_.solve(component, panel_.data(), width);
    for (const int d : dofs)
      for (int k = 0; k < count; ++k) dp(d, k) = row(d)[k];
  }
}

}  // namespace contactvi

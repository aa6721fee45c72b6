#include "step/node_map.hpp"

#include <algorithm>

namespace contactvi {

NodeMap::NodeMap(const Tree& tree)
    : tree_(&tree), model_(tree), pattern_(tree), local_(tree, model_, pattern_, 1), mass_(pattern_, 1), panel_(0) {}

bool NodeMap::take(const VecX& q, const VecX& v) {
  local_.evaluate_at(q, v);
  std::copy(local_.M.low.begin(), local_.M.low.end(), mass_.low(0));
  std::copy(local_.M.up.begin(), local_.M.up.end(), mass_.up(0));
  fold_masses();
  return mass_.factor() && mass_.cancellation() <= kMostCancellation;
}

// S^T M S in the rows and columns of the leaders, and 1 in those of the followers.
void NodeMap::fold_masses() {
  const auto mass = [&](int row, int column) -> double& { return *mass_.at(pattern_.pair(row, column)); };
  const int n = tree_->nv;
  for (const Follower& f : tree_->followers) {
    for (const Follower::Leader& leader : f.leaders) {
      for (int c = 0; c < n; ++c) mass(leader.iv, c) += leader.ratio * mass(f.iv, c);
      for (int r = 0; r < n; ++r) mass(r, leader.iv) += leader.ratio * mass(r, f.iv);
    }
    for (int d = 0; d < n; ++d) mass(f.iv, d) = mass(d, f.iv) = 0.0;
    mass(f.iv, f.iv) = 1.0;
  }
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
    for (const Follower& f : tree_->followers)
      for (int k = 0; k < width; ++k) {
        for (const Follower::Leader& leader : f.leaders) row(leader.iv)[k] += leader.ratio * row(f.iv)[k];
        row(f.iv)[k] = 0.0;
      }
    mass_.solve(component, panel_.data(), width);
    for (const Follower& f : tree_->followers)
      for (int k = 0; k < width; ++k)
        for (const Follower::Leader& leader : f.leaders) row(f.iv)[k] += leader.ratio * row(leader.iv)[k];
    for (const int d : dofs)
      for (int k = 0; k < count; ++k) dp(d, k) = row(d)[k];
  }
}

}  // namespace contactvi

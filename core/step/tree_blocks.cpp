#include "step/tree_blocks.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/gauss.hpp"
#include "model/flat_model.hpp"

namespace contactvi {

int padded_width(int columns) { return (columns + kMaxStages - 1) / kMaxStages * kMaxStages; }

TreeBlocks::TreeBlocks(const DofPattern& pattern, int size)
    : pattern_(&pattern),
      size_(size),
      stride_(size == 1 ? 1 : kMaxStages),
      area_(size * stride_),
      kernel_(&lane_kernel(kMaxStages)),
      low_(static_cast<std::size_t>(pattern.entries()) * area_),
      up_(low_),
      left_(low_),
      right_(low_),
      negative_(static_cast<std::size_t>(pattern.dofs()) * area_) {}

// Y -= block X, or Y = -block X.
void TreeBlocks::subtract(const double* block, const double* X, double* Y, int width, bool anew) const {
  kernel_->subtract_product(size_, size_, width, block, stride_, X, Y, anew);
}

// By Gauss and Jordan, with exchanged rows.
bool TreeBlocks::invert(const double* block, double* negative_inverse) const {
  const int s = size_;
  if (s == 1) {
    negative_inverse[0] = -1.0 / block[0];
    return std::isfinite(negative_inverse[0]);
  }
  double A[kMaxStages][2 * kMaxStages] = {};
  for (int i = 0; i < s; ++i) {
    std::copy_n(block + i * stride_, s, A[i]);
    A[i][kMaxStages + i] = -1.0;
  }
  int row[kMaxStages];
  for (int i = 0; i < s; ++i) row[i] = i;
  for (int k = 0; k < s; ++k) {
    int best = k;
    for (int i = k + 1; i < s; ++i)
      if (std::abs(A[row[i]][k]) > std::abs(A[row[best]][k])) best = i;
    std::swap(row[k], row[best]);
    double* pivot = A[row[k]];
    const double scale = 1.0 / pivot[k];
    if (!std::isfinite(scale)) return false;
    for (int j = 0; j < 2 * kMaxStages; ++j) pivot[j] *= scale;
    for (int i = 0; i < s; ++i) {
      const double factor = A[row[i]][k];
      if (i == k || factor == 0.0) continue;
      for (int j = 0; j < 2 * kMaxStages; ++j) A[row[i]][j] -= factor * pivot[j];
    }
  }
  for (int i = 0; i < s; ++i) std::copy_n(A[row[i]] + kMaxStages, s, negative_inverse + i * stride_);
  return true;
}

bool TreeBlocks::factor() {
  const DofPattern& pattern = *pattern_;
  std::copy_n(up_.data(), up_.size(), left_.data());
  std::copy_n(low_.data(), low_.size(), right_.data());
  double* const left = left_.data();
  double* const right = right_.data();
  cancellation_ = 1.0;
  alignas(64) double turned[kMaxStages * kMaxStages];
  for (int d = pattern.dofs() - 1; d >= 0; --d) {
    double* negative = negative_.data() + d * area_;
    const double* block = right + pattern.diagonal(d) * area_;
    if (!invert(block, negative)) return false;
    cancellation_ = std::max(cancellation_, largest(low(pattern.diagonal(d))) / largest(block));
    for (int g = 0; g < pattern.level(d); ++g) {
      double* block = right + pattern.entry(d, g) * area_;
      if (size_ == 1) {
        block[0] *= -negative[0];
        continue;
      }
      subtract(negative, block, turned, stride_, true);
      std::copy_n(turned, area_, block);
    }
    for (int g = 0; g < pattern.level(d); ++g) {
      const double* up = left + pattern.entry(d, g) * area_;
      const int row = pattern.on_path(d, g);
      for (int k = 0; k < pattern.level(d); ++k) {
        const double* block = right + pattern.entry(d, k) * area_;
        double* target =
            k <= g ? right + pattern.entry(row, k) * area_ : left + pattern.entry(pattern.on_path(d, k), g) * area_;
        if (size_ == 1) {
          target[0] -= up[0] * block[0];
        } else {
          subtract(up, block, target, stride_);
        }
      }
    }
  }
  return true;
}

void TreeBlocks::solve(int component, double* X, int width) {
  const DofPattern& pattern = *pattern_;
  const std::vector<int>& dofs = pattern.components()[component];
  const auto rows = [&](int d) { return X + static_cast<std::size_t>(pattern.place(d)) * size_ * width; };
  for (std::size_t i = dofs.size(); i-- > 0;) {
    const int d = dofs[i];
    subtract(negative_.data() + d * area_, rows(d), rows(d), width, true);
    for (int g = 0; g < pattern.level(d); ++g)
      subtract(left_.data() + pattern.entry(d, g) * area_, rows(d), rows(pattern.on_path(d, g)), width);
  }
  for (const int d : dofs)
    for (int g = 0; g < pattern.level(d); ++g)
      subtract(right_.data() + pattern.entry(d, g) * area_, rows(pattern.on_path(d, g)), rows(d), width);
}

double TreeBlocks::largest(const double* block) const {
  double found = 0.0;
  for (int i = 0; i < area_; ++i) found = std::max(found, std::abs(block[i]));
  return found;
}

double TreeBlocks::backward_error(int component, const double* X, double* B, int width) {
  const DofPattern& pattern = *pattern_;
  const std::vector<int>& dofs = pattern.components()[component];
  const std::size_t rows = static_cast<std::size_t>(size_) * width, numbers = dofs.size() * width;
  // Per dof and column: the largest numbers of X, and the sizes of the terms of a residual.
  of_X_.assign(numbers, 0.0);
  of_terms_.assign(numbers, 0.0);
  const auto take_largest = [&](const double* panel, std::vector<double>& found) {
    for (std::size_t d = 0; d < dofs.size(); ++d)
      for (int i = 0; i < size_; ++i)
        for (int c = 0; c < width; ++c)
          found[d * width + c] = std::max(found[d * width + c], std::abs(panel[d * rows + i * width + c]));
  };
  take_largest(X, of_X_);
  take_largest(B, of_terms_);
  const auto take = [&](const double* block, int row, int column) {
    const std::size_t r = pattern.place(row), k = pattern.place(column);
    subtract(block, X + k * rows, B + r * rows, width);
    const double factor = largest(block);
    for (int c = 0; c < width; ++c) of_terms_[r * width + c] += factor * of_X_[k * width + c];
  };
  for (const int d : dofs) {
    for (int g = 0; g < pattern.level(d); ++g) {
      take(low(pattern.entry(d, g)), d, pattern.on_path(d, g));
      take(up(pattern.entry(d, g)), pattern.on_path(d, g), d);
    }
    take(low(pattern.diagonal(d)), d, d);
  }
  of_X_.assign(numbers, 0.0);
  take_largest(B, of_X_);
  double worst = 0.0;
  for (std::size_t i = 0; i < numbers; ++i) {
    const double error = of_X_[i] == 0.0 ? 0.0 : of_X_[i] / of_terms_[i];
    if (!(error <= worst)) worst = error;  // NaN counts as the worst
  }
  return worst;
}

}  // namespace contactvi

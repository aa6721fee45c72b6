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
  kernel_->subtract_product(size_, width, block, stride_, X, Y, anew);
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
  alignas(64) double turned[kMaxStages * kMaxStages];
  for (int d = pattern.dofs() - 1; d >= 0; --d) {
    double* negative = negative_.data() + d * area_;
    if (!invert(right + pattern.diagonal(d) * area_, negative)) return false;
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
        double* target = k <= g ? right + pattern.entry(row, k) * area_
                                : left + pattern.entry(pattern.on_path(d, k), g) * area_;
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

double TreeBlocks::backward_error(int component, const double* X, double* B, int width) {
  const DofPattern& pattern = *pattern_;
  const std::vector<int>& dofs = pattern.components()[component];
  const std::size_t rows = static_cast<std::size_t>(size_) * width;
  sizes_.assign(dofs.size() * width, 0.0);
  const auto largest = [&](const double* numbers, double* of_column) {
    for (int i = 0; i < size_; ++i)
      for (int c = 0; c < width; ++c) of_column[c] = std::max(of_column[c], std::abs(numbers[i * width + c]));
  };
  std::vector<double>& of_column = column_;
  for (const int d : dofs) {
    const double* block = low(pattern.diagonal(d));
    double norm = 0.0;
    for (int i = 0; i < area_; ++i) norm = std::max(norm, std::abs(block[i]));
    of_column.assign(width, 0.0);
    largest(X + pattern.place(d) * rows, of_column.data());
    double* size = sizes_.data() + pattern.place(d) * width;
    largest(B + pattern.place(d) * rows, size);
    for (int c = 0; c < width; ++c) size[c] += norm * of_column[c];
  }
  for (const int d : dofs) {
    const double* x = X + pattern.place(d) * rows;
    double* b = B + pattern.place(d) * rows;
    subtract(low(pattern.diagonal(d)), x, b, width);
    for (int g = 0; g < pattern.level(d); ++g) {
      const std::size_t other = pattern.place(pattern.on_path(d, g)) * rows;
      subtract(low(pattern.entry(d, g)), X + other, b, width);
      subtract(up(pattern.entry(d, g)), x, B + other, width);
    }
  }
  double worst = 0.0;
  for (std::size_t d = 0; d < dofs.size(); ++d) {
    of_column.assign(width, 0.0);
    largest(B + d * rows, of_column.data());
    for (int c = 0; c < width; ++c) {
      const double error = of_column[c] == 0.0 ? 0.0 : of_column[c] / sizes_[d * width + c];
      if (!(error <= worst)) worst = error;
    }
  }
  return worst;
}

}  // namespace contactvi

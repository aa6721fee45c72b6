#include "base/interpolation.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

void Interpolation::add(double t, const VecX& x) {
  int place = static_cast<int>(std::find(t_, t_ + count_, t) - t_);
  if (place == count_) {
    if (count_ == kMost) place = kFixed + (added_ - kFixed) % (kMost - kFixed);
    count_ = std::max(count_, place + 1);
    ++added_;
  }
  t_[place] = t;
  x_[place] = x;
}

void Interpolation::value(double t, VecX& x) const {
  int near[kMost], used[kUsed], found = 0;
  for (int k = 0; k < count_; ++k) near[k] = k;
  std::stable_sort(near, near + count_, [&](int a, int b) { return std::abs(t_[a] - t) < std::abs(t_[b] - t); });
  for (int k = 0; k < count_ && found < kUsed; ++k) {
    bool apart = true;
    for (int j = 0; j < found; ++j) apart &= std::abs(t_[near[k]] - t_[used[j]]) > kApart * std::abs(t_[near[k]] - t);
    if (apart) used[found++] = near[k];
  }
  for (int i = 0; i < found; ++i) {
    double weight = 1.0;
    for (int j = 0; j < found; ++j)
      if (j != i) weight *= (t - t_[used[j]]) / (t_[used[i]] - t_[used[j]]);
    if (i == 0)
      x = weight * x_[used[0]];
    else
      x += weight * x_[used[i]];
  }
}

}  // namespace contactvi

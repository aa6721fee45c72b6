// Sets of numbers that belong together; the smallest number of a set names it.
#pragma once

#include <algorithm>
#include <numeric>
#include <vector>

namespace contactvi {

class DisjointSets {
 public:
  explicit DisjointSets(int count = 0) { reset(count); }

  // Every number alone.
  void reset(int count) {
    parent_.resize(count);
    std::iota(parent_.begin(), parent_.end(), 0);
  }
  // Takes a number out of its set, which has to be done with all of a set.
  void isolate(int i) { parent_[i] = i; }
  int root(int i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  bool joined(int a, int b) { return root(a) == root(b); }
  // A number below zero joins nothing.
  void join(int a, int b) {
    if (a < 0 || b < 0) return;
    a = root(a);
    b = root(b);
    parent_[std::max(a, b)] = std::min(a, b);
  }

 private:
  std::vector<int> parent_;
};

}  // namespace contactvi

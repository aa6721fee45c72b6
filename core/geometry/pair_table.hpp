// The pairs of a scene by their geometries.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

namespace contactvi {

struct Pair;

class PairTable {
 public:
  explicit PairTable(const std::vector<Pair>& pairs, std::size_t geometries);

  struct Entry {
    int other, guard;
  };
  // Calls look(guard) for each pair of the two geometries.
  template <class Look>
  void each(int a, int b, Look look) const {
    if (a > b) std::swap(a, b);
    int low = start_[a], high = start_[a + 1];
    while (low < high) {
      const int middle = low + (high - low) / 2;
      (entries_[middle].other < b ? low : high) = entries_[middle].other < b ? middle + 1 : middle;
    }
    for (; low < start_[a + 1] && entries_[low].other == b; ++low) look(entries_[low].guard);
  }

 private:
  // The pairs whose smaller geometry is g: entries_[start_[g] .. start_[g + 1]), ascending by the larger one.
  std::vector<int> start_;
  std::vector<Entry> entries_;
};

}  // namespace contactvi

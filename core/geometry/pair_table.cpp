#include "geometry/pair_table.hpp"

#include <algorithm>

#include "model/scene.hpp"

namespace contactvi {

PairTable::PairTable(const std::vector<Pair>& pairs, std::size_t geometries)
    : start_(geometries + 1, 0), entries_(pairs.size()) {
  for (const Pair& pair : pairs) ++start_[std::min(pair.a, pair.b) + 1];
  for (std::size_t g = 0; g < geometries; ++g) start_[g + 1] += start_[g];
  std::vector<int> next(start_.begin(), start_.end() - 1);
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    const auto [small, large] = std::minmax(pairs[k].a, pairs[k].b);
    entries_[next[small]++] = {large, static_cast<int>(k)};
  }
  for (std::size_t g = 0; g < geometries; ++g)
    std::sort(entries_.begin() + start_[g], entries_.begin() + start_[g + 1], [](const Entry& s, const Entry& t) {
      return s.other != t.other ? s.other < t.other : s.guard < t.guard;
    });
}

}  // namespace contactvi

// Central differences of fourth order: f'(x) = sum of weight f(x + count step) / (kDifferenceParts step).
#pragma once

namespace contactvi {

struct DifferenceTerm {
  double count, weight;
};
inline constexpr DifferenceTerm kDifference[] = {{-2.0, 1.0}, {-1.0, -8.0}, {1.0, 8.0}, {2.0, -1.0}};
inline constexpr double kDifferenceParts = 12.0;

}  // namespace contactvi

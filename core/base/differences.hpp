// Differences of fourth order. Central ones: f'(x) = sum of weight f(x + count step) / (kDifferenceParts step).
#pragma once

namespace contactvi {

struct DifferenceTerm {
  double count, weight;
};
inline constexpr DifferenceTerm kDifference[] = {{-2.0, 1.0}, {-1.0, -8.0}, {1.0, 8.0}, {2.0, -1.0}};
inline constexpr double kDifferenceParts = 12.0;

// On one side: f'(x) = sum of kOneSided[i] f(x - i step) / (kDifferenceParts step).
inline constexpr double kOneSided[] = {25.0, -48.0, 36.0, -16.0, 3.0};

}  // namespace contactvi

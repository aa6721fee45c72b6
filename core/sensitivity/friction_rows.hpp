// The rows of the friction of a contact point, in laws that are differentiated: those against its slip, with the spin
// as a third component where that has a radius, and those against rolling.
#pragma once

#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

struct FrictionRows {
  int row, count;  // the first one, and how many
  bool rolls;      // friction against rolling, which is at most the normal impulse: its rows are times the radius
};

// Of a point with so many rows, of which the normal one is `row`.
inline std::vector<FrictionRows> friction_rows(int row, int rows) {
  if (rows == 1) return {};
  const int count = rows % 2 == 0 ? 3 : 2;
  std::vector<FrictionRows> found{{row + 1, count, false}};
  if (rows > 4) found.push_back({row + 1 + count, 2, true});
  return found;
}

// d(s / |s|) / ds.
inline MatX turn_of(const VecX& s) {
  const VecX d = s.normalized();
  return (MatX::Identity(s.size(), s.size()) - d * d.transpose()) / s.norm();
}

}  // namespace contactvi

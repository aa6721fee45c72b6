// The convex hull of points in a plane, by the monotone chain (Andrew 1979).
#pragma once

#include <algorithm>
#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

// Writes the numbers of the corners to `hull`, anticlockwise from the least point. points: numbers of the points; they
// are sorted. at(i): coordinates of point i, shape (2,). turns(i, j, k): whether the chain from i over j to k turns
// left, so that j is a corner. Fewer than two corners for fewer than two points.
template <class At, class Turns>
void planar_hull(std::vector<int>& points, At at, Turns turns, std::vector<int>& hull) {
  std::sort(points.begin(), points.end(), [&](int i, int j) {
    const Eigen::Vector2d a = at(i), b = at(j);
    return a[0] != b[0] ? a[0] < b[0] : a[1] != b[1] ? a[1] < b[1] : i < j;
  });
  hull.clear();
  for (int pass = 0; pass < 2; ++pass) {  // the lower side, then the upper one
    const std::size_t start = hull.size();
    for (int i : points) {
      while (hull.size() >= start + 2 && !turns(hull[hull.size() - 2], hull.back(), i)) hull.pop_back();
      hull.push_back(i);
    }
    hull.pop_back();
    std::reverse(points.begin(), points.end());
  }
}

}  // namespace contactvi

#include "selection.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {

// A point must add this part of the extent (squared) to the area to count.
constexpr double kLeastArea = 1e-9;
// Equal to rounding: the first of them is taken.
constexpr double kTie = 1e-9;

using Vec2 = Eigen::Vector2d;

double wedge(const Vec2& o, const Vec2& p, const Vec2& q) {
  return (p[0] - o[0]) * (q[1] - o[1]) - (p[1] - o[1]) * (q[0] - o[0]);
}

// What x adds to the convex polygon of the points `corners` (anticlockwise, at least two).
double added_area(const std::vector<Vec2>& at, const std::vector<int>& corners, const Vec2& x) {
  double area = 0.0;
  const std::size_t n = corners.size();
  for (std::size_t k = 0; k < n; ++k) area += std::max(0.0, -0.5 * wedge(at[corners[k]], at[corners[(k + 1) % n]], x));
  return area;
}

// Puts x among the corners of a convex polygon, after the side that sees it most.
void insert_corner(const std::vector<Vec2>& at, std::vector<int>& corners, int x) {
  const std::size_t n = corners.size();
  std::size_t best = n;
  double most = 0.0;
  for (std::size_t k = 0; k < n; ++k) {
    const double area = -wedge(at[corners[k]], at[corners[(k + 1) % n]], at[x]);
    if (area <= most) continue;
    most = area;
    best = k + 1;
  }
  corners.insert(corners.begin() + static_cast<std::ptrdiff_t>(best), x);
}

// The candidates seen along n, without those at the place of another one.
void project(const std::vector<Candidate>& all, const Vec3& n, std::vector<Vec2>& at, std::vector<int>& open) {
  Eigen::Index smallest;
  n.cwiseAbs().minCoeff(&smallest);
  const Vec3 u = n.cross(Vec3::Unit(smallest)).normalized(), v = n.cross(u);
  for (const Candidate& c : all) at.emplace_back(u.dot(c.x_W - all[0].x_W), v.dot(c.x_W - all[0].x_W));
  for (int i = 0; i < static_cast<int>(all.size()); ++i) {
    auto same = std::find_if(open.begin(), open.end(),
                             [&](int j) { return (at[i] - at[j]).squaredNorm() < kSamePlace * kSamePlace; });
    if (same == open.end()) {
      open.push_back(i);
    } else if (all[i].gap < all[*same].gap - kSameGap) {
      *same = i;
    }
  }
}

}  // namespace

void select_candidates(const std::vector<Candidate>& all, const Vec3& n, int most, std::vector<int>& chosen) {
  chosen.clear();
  if (all.empty()) return;
  if (all.size() == 1) {
    chosen.push_back(0);
    return;
  }
  std::vector<Vec2> at;
  std::vector<int> open;
  project(all, n, at, open);
  double deepest = all[open[0]].gap;
  for (int i : open) deepest = std::min(deepest, all[i].gap);
  const int first = *std::find_if(open.begin(), open.end(), [&](int i) { return all[i].gap <= deepest + kSameGap; });
  std::vector<int>& corners = chosen;
  corners.push_back(first);
  double extent = 0.0;
  while (static_cast<int>(corners.size()) < most) {
    int best = -1;
    double gain = corners.size() == 1 ? 0.0 : kLeastArea * extent * extent;
    for (int i : open) {
      const double g = corners.size() == 1                                             ? (at[i] - at[first]).norm()
                       : std::find(corners.begin(), corners.end(), i) != corners.end() ? 0.0
                                                                                       : added_area(at, corners, at[i]);
      if (g <= gain * (1.0 + kTie)) continue;
      gain = g;
      best = i;
    }
    if (best < 0) break;
    if (corners.size() == 1) {
      extent = gain;
      corners.push_back(best);
    } else {
      insert_corner(at, corners, best);
    }
  }
  std::sort(chosen.begin(), chosen.end());
}

}  // namespace contactvi

// The choice of a few contact points, which span the area of the contact, from many candidates.
#pragma once

#include <vector>

#include "geometry/candidates.hpp"

namespace contactvi {

// Candidates closer to each other than this [m], seen along the normal, are one point.
constexpr double kSamePlace = 1e-7;
// Gaps that differ by less [m] are equal, so that rounding does not decide which corner of a resting face is the
// deepest.
constexpr double kSameGap = 1e-11;

class Selection {
 public:
  // Indices of at most `most` candidates, ascending: the deepest, and those that with it span the largest area seen
  // along n (world frame), found by adding the best one by one and then exchanging. Points that add no area are left
  // out.
  const std::vector<int>& choose(const std::vector<Candidate>& candidates, const Vec3& n, int most);

 private:
  using Vec2 = Eigen::Vector2d;
  void project(const std::vector<Candidate>& all, const Vec3& n);
  double set_hull(int skipped);
  double area_added(int point) const;
  void add_one_by_one(int most);
  void exchange();

  // Workspace. at_: all candidates in the plane; distinct_: without those at the position of another one.
  std::vector<Vec2> at_;
  std::vector<bool> deepest_;
  std::vector<int> distinct_, chosen_, subset_, hull_;
};

}  // namespace contactvi

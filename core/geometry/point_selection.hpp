// Which of many candidates stand for a contact: a few that span its area.
#pragma once

#include <vector>

#include "geometry/candidates.hpp"

namespace contactvi {

// Two candidates nearer than this [m], seen along the normal, are one point.
constexpr double kSamePlace = 1e-7;
// Gaps that differ less [m] are equal: which of a resting face's corners is the deepest by rounding must not matter.
constexpr double kSameGap = 1e-11;

class Selection {
 public:
  // Indices of at most `most` candidates, ascending: the deepest, and those that with it span the largest area seen
  // along n (world frame), found by adding the best one by one and then exchanging; none that adds nothing.
  const std::vector<int>& choose(const std::vector<Candidate>& candidates, const Vec3& n, int most);

 private:
  using Vec2 = Eigen::Vector2d;
  void project(const std::vector<Candidate>& all, const Vec3& n);
  double area_with(int skipped, int added);
  void add_one_by_one(int most);
  void exchange();

  // Scratch. at_: all candidates in the plane; open_: without those at the place of another one.
  std::vector<Vec2> at_;
  std::vector<bool> deepest_;
  std::vector<int> open_, chosen_, some_, hull_;
};

}  // namespace contactvi

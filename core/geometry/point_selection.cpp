#include "geometry/point_selection.hpp"

#include <algorithm>
#include <cmath>

#include "geometry/planar_hull.hpp"

namespace contactvi {

namespace {

// A point adds area only if that is at least this part of the extent squared.
constexpr double kLeastArea = 1e-9;
// Values that differ by less are equal: the first point is chosen.
constexpr double kTie = 1.0 + 1e-9;
// Passes of exchanges at most; rarely more than two are needed.
constexpr int kMaxExchanges = 8;

double wedge(const Eigen::Vector2d& o, const Eigen::Vector2d& p, const Eigen::Vector2d& q) {
  return (p[0] - o[0]) * (q[1] - o[1]) - (p[1] - o[1]) * (q[0] - o[0]);
}

}  // namespace

void Selection::project(const std::vector<Candidate>& all, const Vec3& n) {
  Eigen::Index smallest;
  n.cwiseAbs().minCoeff(&smallest);
  const Vec3 u = n.cross(Vec3::Unit(smallest)).normalized(), v = n.cross(u);
  at_.clear();
  distinct_.clear();
  for (const Candidate& c : all) at_.emplace_back(u.dot(c.x_W - all[0].x_W), v.dot(c.x_W - all[0].x_W));
  for (int i = 0; i < static_cast<int>(all.size()); ++i) {
    auto same = std::find_if(distinct_.begin(), distinct_.end(),
                             [&](int j) { return (at_[i] - at_[j]).squaredNorm() < kSamePlace * kSamePlace; });
    if (same == distinct_.end()) {
      distinct_.push_back(i);
    } else if (all[i].gap < all[*same].gap - kSameGap) {
      *same = i;
    }
  }
}

// Sets hull_ to the convex hull of the chosen points, without the one at place `skipped` (-1: none); returns twice its
// area.
double Selection::set_hull(int skipped) {
  subset_.clear();
  for (int k = 0; k < static_cast<int>(chosen_.size()); ++k)
    if (k != skipped) subset_.push_back(chosen_[k]);
  planar_hull(
      subset_, [&](int i) { return at_[i]; }, [&](int i, int j, int k) { return wedge(at_[i], at_[j], at_[k]) > 0.0; },
      hull_);
  double twice = 0.0;
  for (std::size_t k = 2; k < hull_.size(); ++k) twice += wedge(at_[hull_[0]], at_[hull_[k - 1]], at_[hull_[k]]);
  return twice;
}

// Twice the area by which another point makes hull_ larger: the triangles over the sides that it sees.
double Selection::area_added(int point) const {
  double twice = 0.0;
  for (std::size_t k = 0; k < hull_.size(); ++k) {
    const int next = hull_[k + 1 < hull_.size() ? k + 1 : 0];
    twice += std::max(0.0, -wedge(at_[hull_[k]], at_[next], at_[point]));
  }
  return twice;
}

void Selection::add_one_by_one(int most) {
  double extent = 0.0;
  while (static_cast<int>(chosen_.size()) < most) {
    const bool second = chosen_.size() == 1;
    const double area = second ? 0.0 : set_hull(-1);
    int best = -1;
    double largest = second ? 0.0 : area + 2.0 * kLeastArea * extent * extent;
    for (int i : distinct_) {
      const double value = second ? (at_[i] - at_[chosen_[0]]).norm() : area + area_added(i);
      if (value <= largest * kTie) continue;
      largest = value;
      best = i;
    }
    if (best < 0) return;
    chosen_.push_back(best);
    if (second) extent = largest;
  }
}

// Exchanges a chosen point for another one where that gives a larger area and one of the deepest points remains.
void Selection::exchange() {
  if (chosen_.size() < 3 || chosen_.size() == distinct_.size()) return;
  double area = set_hull(-1);
  for (int pass = 0; pass < kMaxExchanges; ++pass) {
    const double before = area;
    for (int k = 0; k < static_cast<int>(chosen_.size()); ++k) {
      int deep = 0;
      for (int j = 0; j < static_cast<int>(chosen_.size()); ++j) deep += j != k && deepest_[chosen_[j]];
      const double others = set_hull(k);
      for (int i : distinct_) {
        if (deep == 0 && !deepest_[i]) continue;
        const double value = others + area_added(i);
        if (value <= area * kTie) continue;
        area = value;
        chosen_[k] = i;
      }
    }
    if (area == before) return;
  }
}

const std::vector<int>& Selection::choose(const std::vector<Candidate>& all, const Vec3& n, int most) {
  chosen_.clear();
  if (all.size() <= 1) {
    if (!all.empty()) chosen_.push_back(0);
    return chosen_;
  }
  project(all, n);
  double deepest = all[distinct_[0]].gap;
  for (int i : distinct_) deepest = std::min(deepest, all[i].gap);
  deepest_.assign(all.size(), false);
  for (int i : distinct_) deepest_[i] = all[i].gap <= deepest + kSameGap;
  chosen_.push_back(*std::find_if(distinct_.begin(), distinct_.end(), [&](int i) { return deepest_[i]; }));
  add_one_by_one(most);
  exchange();
  std::sort(chosen_.begin(), chosen_.end());
  return chosen_;
}

}  // namespace contactvi

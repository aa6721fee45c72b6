// What the searches for common normals share: damped Newton steps along two ways, which lessen a signed distance with
// the eigenvalues of its Hessian made positive, and the list of what they find.
#pragma once

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <vector>

#include "base/numerics.hpp"
#include "model/common_normal.hpp"
#include "model/foot_search.hpp"

namespace contactvi {

// Of the size of a cell: cells that are no farther from each other may hold an overlap, whatever gap was found.
constexpr double kDeepest = 0.1;
// Times the size of a cell: curvatures that are less count as this much in a step, and as flat in what is found; with a
// lower one than the second a place is a saddle.
constexpr double kFlatOfSize = 1e-4, kSaddleOfSize = -1e-6;
// [m] Gaps that are this near to zero are known to rounding, and a place may seem to lie on the other side.
constexpr double kSideRounding = 1e-9;
// Of the size of a cell: common normals that are no farther from each other are one; along a flat way.
constexpr double kOneNormal = 1e-6, kOneFlat = 0.5;
// Of the size of a cell: the way from a saddle to a place beside it.
constexpr double kBesideSaddle = 0.3;

class DistanceSearch {
 public:
  bool found() const { return found_ && !is_saddle(); }
  bool at_saddle() const { return found_ && is_saddle(); }
  double least() const { return least_; }  // of the curvatures of the distance

 protected:
  using Vec2 = Eigen::Vector2d;
  using Mat2 = Eigen::Matrix2d;
  using Ways = Eigen::Matrix<double, 3, 2>;

  explicit DistanceSearch(double size) : size_(size) {}

  // From a place that was set and has its step. go(step): sets the place there, false where the distance does not fall
  // to it; choose(): the step from the place; is_far(): whether the search ends without a place.
  template <class Go, class Choose, class IsFar>
  void slide(const Go& go, const Choose& choose, const IsFar& is_far) {
    for (int round = 0; round < kRounds && !ends_; ++round) {
      if (last_) ends_ = true;
      if (!go(step_)) {
        damping_ = std::max(kFirstDamping * stiffest_, kMore * damping_);
        if (damping_ > kMostDamping * stiffest_) return;
      } else {
        damping_ = damping_ * kLess < kNoDamping * stiffest_ ? 0.0 : damping_ * kLess;
      }
      if (is_far()) return;
      choose();
    }
    found_ = (ends_ || settled_) && skew_ <= kOpposite;
  }

  // Whether the distance falls to f, which it then is; what rounding adds to it at the last step does not count.
  bool falls_to(double f) {
    const double rounding = kSameGapOfSize * size_ + kSquareRounding * std::abs(f);
    if (!(ends_ || f <= f_ + rounding)) return false;
    settled_ = std::abs(f - f_) <= rounding;
    f_ = f;
    return true;
  }

  // By the derivatives of the distance along the ways.
  void choose_step(const Vec2& gradient, const Mat2& hessian) {
    const Eigen::SelfAdjointEigenSolver<Mat2> eigen(hessian);
    const Vec2 values = eigen.eigenvalues();
    const double flat = kFlatOfSize / size_;
    least_ = values[0];
    softest_ = eigen.eigenvectors().col(0);
    skew_ = gradient.norm();
    stiffest_ = std::max(values.cwiseAbs().maxCoeff(), flat);
    const Vec2 along = eigen.eigenvectors().transpose() * gradient, positive = values.cwiseAbs().cwiseMax(flat);
    last_ = along.cwiseQuotient(positive).norm() <= kLastSlide * size_;
    step_ = -eigen.eigenvectors() * along.cwiseQuotient(positive + Vec2::Constant(damping_));
    const double length = step_.norm(), longest = kLongestSlide * size_;
    if (length > longest) step_ *= longest / length;
  }

  double f() const { return f_; }
  bool is_flat() const { return least_ * size_ < kFlatOfSize; }
  // From a saddle along the way in which the distance falls.
  Vec2 to_beside(double sign) const { return sign * kBesideSaddle * size_ * softest_; }

 private:
  static constexpr int kRounds = 40;
  // Of the size of a cell: no longer step; a shorter one is the last, Newton's method doubles the digits. A valley in
  // which the distance falls by rounding alone needs no more of them.
  static constexpr double kLongestSlide = 1.0, kLastSlide = 1e-9, kSameGapOfSize = 1e-14;
  static constexpr double kMostDamping = 1e8;  // of the largest curvature: the distance falls nowhere
  // Sine of the angle between the normals, from which on they are not opposite.
  static constexpr double kOpposite = 1e-6;

  bool is_saddle() const { return !(least_ * size_ >= kSaddleOfSize); }

  double size_, f_ = kInfinity;  // size: of a cell, across [m]
  Vec2 step_ = Vec2::Zero(), softest_ = Vec2::UnitX();
  double damping_ = 0.0, least_ = 0.0, stiffest_ = 1.0, skew_ = kInfinity;
  bool last_ = false, ends_ = false, settled_ = false, found_ = false;
};

// The common normals that searches have found, each once, and which of the known ones each of them is.
class FoundNormals {
 public:
  FoundNormals(std::vector<CommonNormal>& found, std::vector<int>& number, double size, double nearest)
      : found_(found), number_(number), size_(size), nearest_(nearest) {
    found.clear();
    number.clear();
  }

  double nearest() const { return nearest_; }  // the least gap, or a bound on it
  const std::vector<CommonNormal>& found() const { return found_; }
  void add(const CommonNormal& c, int which) {
    nearest_ = std::min(nearest_, c.gap);
    const bool is_new = std::none_of(found_.begin(), found_.end(), [&](const CommonNormal& o) {
      const double same = size_ * (c.is_flat && o.is_flat ? kOneFlat : kOneNormal);
      return o.part == c.part && (o.second - c.second).norm() <= same && (o.first - c.first).norm() <= same;
    });
    if (is_new) put(c, which);
  }
  // One that is not compared with the others.
  void put(const CommonNormal& c, int which) {
    found_.push_back(c);
    number_.push_back(which);
  }
  // Keeps the k-th ones for which keeps(k).
  template <class Keeps>
  void keep(const Keeps& keeps) {
    std::size_t kept = 0;
    for (std::size_t k = 0; k < found_.size(); ++k) {
      if (!keeps(k)) continue;
      found_[kept] = found_[k];
      number_[kept++] = number_[k];
    }
    found_.resize(kept);
    number_.resize(kept);
  }
  // Of those that were found before a nearer one was, only the ones within reach.
  void keep_within(double reach) {
    double nearest = kInfinity;
    for (const CommonNormal& c : found_) nearest = std::min(nearest, c.gap);
    keep([&](std::size_t k) { return !(found_[k].gap > std::max(reach, nearest)); });
  }

 private:
  std::vector<CommonNormal>& found_;
  std::vector<int>& number_;
  double size_, nearest_;
};

}  // namespace contactvi

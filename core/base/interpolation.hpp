// A vector as a function of a number, known at some of them: the polynomial through the points next to where it is
// asked for.
#pragma once

#include "base/numerics.hpp"

namespace contactvi {

class Interpolation {
 public:
  bool empty() const { return count_ == 0; }
  void clear() { count_ = added_ = 0; }
  // Adds the value x at t, all of one size. The first two that were added since clear() stay; of the others the last
  // ones are kept.
  void add(double t, const VecX& x);
  // The value at t by the parabola through the three points next to it, or by as many as there are that lie far enough
  // from each other; not to be called while empty.
  void value(double t, VecX& x) const;

 private:
  static constexpr int kFixed = 2, kMost = 5, kUsed = 3;  // points that stay, points kept, those of one polynomial
  // Points closer to each other than this part of their distance to t are used as one: the polynomial through both
  // would multiply what their values are off by.
  static constexpr double kApart = 0.1;

  int count_ = 0, added_ = 0;
  double t_[kMost];
  VecX x_[kMost];
};

}  // namespace contactvi

// The gap of a guard along the path of a step, for the price of geometry alone: where does it first come to zero?
//
// An interval is free if its two gaps add up to more than the bodies can move in it: beyond that bound on the speed
// nothing is assumed of the gap. Intervals in which the bodies turn little and that are a small part of the step are
// cut further until the gap follows the cubic through its values and rates; then tangents rule a dip out.
#pragma once

#include "geometry/guard.hpp"
#include "step/path.hpp"

namespace contactvi {

class GapPath {
 public:
  explicit GapPath(Guards& guards);

  struct Point {
    double tau, gap, rate;  // rate: d(gap)/d(tau)
  };
  enum class Course {
    kClear,     // > 0
    kCrossing,  // > 0 at lo, <= 0 at hi
    kDoubtful,  // > 0, in a dip between lo and hi nearer to zero than the path is true
    kFailed     // not finite
  };

  // The path to look at, raised; the guards' motion and doubt over this step have been bound.
  void set(const StepPath& path) { path_ = &path; }
  Point at(int guard, double tau);
  // Rate at tau of a gap with the gradient W there, shape (nv,).
  double rate(double tau, const VecX& W);

  // The first event of the guard between from, with a gap > 0, and to.
  Course first(int guard, const Point& from, const Point& to, Point& lo, Point& hi);
  // Where the gap plus offset is zero; it is > 0 at lo and <= 0 at hi.
  double root(int guard, Point lo, Point hi, double offset);
  // Where the gap with slope added to its rate is least, in [a, b].
  double minimum(int guard, Point a, Point b, double slope);
  // How far off the exact gap may be; at its ends the path is exact.
  double doubt(int guard, double tau) const;
  // Longest part of the step over which the gap is taken for smooth.
  double smooth_width(int guard) const;

 private:
  Course search(int guard, const Point& a, const Point& b, double mismatch, Point& lo, Point& hi);

  Guards* guards_;
  const StepPath* path_ = nullptr;
  VecX q_, v_, W_;
  Contact contact_;
};

}  // namespace contactvi

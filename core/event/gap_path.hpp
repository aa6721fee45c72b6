// The gap of a guard along the path of a step, evaluated by geometry alone: where does it first come to zero?
//
// An interval has no zero if its two gaps add up to more than the bodies can move in it, or if the shapes are so far
// from each other along one direction at both ends that no distance along it can bend to zero between them: apart from
// these bounds on speed and acceleration nothing is assumed about the gap. Other intervals in which the bodies turn
// little and that are a small part of the step are cut further until the gap follows the cubic through its values and
// rates; then tangents exclude a dip.
#pragma once

#include <limits>

#include "geometry/guard.hpp"
#include "step/path.hpp"

namespace contactvi {

class GapPath {
 public:
  explicit GapPath(Guards& guards);

  struct Point {
    double tau, gap, rate;  // rate: d(gap)/d(tau)
    // A lower bound on the gap, the distance along a direction that the base of the pair keeps; none: minus infinity.
    double along = -std::numeric_limits<double>::infinity();
    Vec3 direction = Vec3::Zero();
  };
  enum class Course {
    kClear,     // > 0
    kCrossing,  // > 0 at lo, <= 0 at hi
    kDoubtful,  // > 0, in a dip between lo and hi that is nearer to zero than the path's error
    kFailed     // not finite
  };

  // Sets the path, which has been raised or leant; the guards' motion and doubt over its step have been bounded.
  void set(const StepPath& path);
  Point at(int guard, double tau);
  // As this, with the distance along the direction of the contact there.
  Point at_with_direction(int guard, double tau);
  // d(gap)/d(tau) at tau of the guard's gap with the gradient W there, shape (nv,).
  double rate(int guard, double tau, const VecX& W);

  // A larger gap of a guard need not be known: what is a clear interval does not depend on how much larger it is.
  double enough(int guard) const;

  // As at, of the shapes of a pair along a direction that their base keeps.
  double along(int guard, double tau, const Vec3& direction);
  // The least that a distance along one direction may be on the exact path between two places, `width` apart, where it
  // is a and b on this one.
  double least_between(int guard, double a, double b, double width) const;
  // As this of the whole step, with exact ends; held: a persistent point over a halfspace touches at both.
  double least_in_step(int guard, double start, double end, bool held) const;
  // Whether all features but the persistent points of a guard stay open in the step.
  bool others_stay_open(int guard);
  // As at_with_direction, where the bodies are placed, of the contact there.
  void look_along(int guard, const Contact& contact, Point& point);
  // Whether the guard's gap, positive at both ends of the step, stays so beyond doubt, from these ends alone.
  bool plainly_clear(int guard, const Point& start, double end_gap);
  // The first event of the guard between from, with a gap > 0, and to.
  Course first(int guard, const Point& from, const Point& to, Point& lo, Point& hi);
  // Place where the gap plus offset is zero; it is > 0 at lo and <= 0 at hi.
  double root(int guard, Point lo, Point hi, double offset);
  // Place in [a, b] where the gap, with slope added to its rate, is least.
  double minimum(int guard, Point a, Point b, double slope);
  // Bound on the difference between the gap on the path and the exact one; at its ends the path is exact.
  double doubt(int guard, double tau) const;
  // Longest part of the step over which the gap counts as smooth.
  double smooth_width(int guard) const;

 private:
  Course search(int guard, const Point& a, const Point& b, double mismatch, Point& lo, Point& hi);
  bool stays_open(int guard, const Point& known, const Point& here);

  Guards* guards_;
  const StepPath* path_ = nullptr;
  // Where only the guard's own joints are placed; the others are at the start of the step.
  VecX q_;
  VecX v_;  // zero but inside of rate
  VecX W_, bend_;
  std::vector<int> joints_;
  Contact contact_;
};

}  // namespace contactvi

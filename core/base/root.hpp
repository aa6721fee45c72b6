// Bracketed roots of scalar functions: each method keeps an interval in which the sign changes, so none can run away.
//
// Which one fits depends on what a function can tell: its value, its value and rate, or only on which side it is.
#pragma once

#include <algorithm>
#include <cmath>

#include "base/numerics.hpp"
#include "base/tolerances.hpp"

namespace contactvi {

// The largest x in [0, 1] with slope x + square x^2 <= room, where square, room >= 0; without cancellation.
inline double largest_share(double slope, double square, double room) {
  const double root = std::sqrt(slope * slope + 4.0 * square * room);
  const double x = slope > 0.0 ? 2.0 * room / (slope + root) : square > 0.0 ? (root - slope) / (2.0 * square) : 1.0;
  return std::clamp(x, 0.0, 1.0);
}

// Value of a function of one variable and its derivative.
struct ValueAndRate {
  double value, rate;
};

// Root in [low, high] of a function that is > 0 at low and <= 0 at high: Newton's method from x, replaced by a
// bisection where it would leave the bracket, and every sixth time in case Newton's method is slow. Ends where |value|
// <= target, or where the bracket is as narrow as rounding allows. evaluate(x) gives a ValueAndRate.
template <class Evaluate>
double root_by_rate(double low, double high, double x, double target, int max_evaluations, Evaluate evaluate) {
  for (int k = 0; k < max_evaluations; ++k) {
    const ValueAndRate at = evaluate(x);
    if (!(std::abs(at.value) > target)) return x;
    (at.value > 0.0 ? low : high) = x;
    const double newton = x - at.value / at.rate;
    const bool inside = newton > low && newton < high && k % 6 != 5;
    const double next = inside ? newton : 0.5 * (low + high);
    if (next == x || high - low <= kNarrowestBracket * high) return x;
    x = next;
  }
  return x;
}

// Root in (0, high] of a function that falls from low_value >= 0 at 0 to high_value < 0 at high: the Illinois method
// (Dowell, Jarratt, "A modified regula falsi method for computing the root of an equation", BIT 11, 1971), with a
// bisection every eighth time. Ends where |value| <= small, or where the bracket is narrower than width; the function
// has then been evaluated last at the root. value(x, fx) sets fx, and is false where the function cannot be evaluated:
// the search then ends with false.
template <class Value>
bool root_by_value(double low_value, double high, double high_value, double small, double width, int max_evaluations,
                   Value value, double& root) {
  double a = 0.0, b = high, fa = low_value, fb = high_value;
  root = high;
  int side = 0;
  for (int k = 0; k < max_evaluations && b - a > width; ++k) {
    double x = 0.5 * (a + b);
    if (fa > fb && k % 8 != 7) x = b - fb * (b - a) / (fb - fa);
    if (!(x > a && x < b)) x = 0.5 * (a + b);
    double fx = 0.0;
    if (!value(x, fx)) return false;
    root = x;
    if (std::abs(fx) <= small) return true;
    if (fx < 0.0) {
      b = x;
      fb = fx;
      if (side < 0) fa *= 0.5;
      side = -1;
    } else {
      a = x;
      fa = fx;
      if (side > 0) fb *= 0.5;
      side = 1;
    }
  }
  root = b;
  double fx = 0.0;
  return value(root, fx);
}

struct PointOfFunction {
  double x, f;
};
// Where a parabola x(f) through three points of a function, or a line through two, meets f = 0.
inline double meets_zero(const PointOfFunction& a, const PointOfFunction& b, const PointOfFunction& c) {
  return a.x * b.f / (b.f - a.f) * c.f / (c.f - a.f) + b.x * a.f / (a.f - b.f) * c.f / (c.f - b.f) +
         c.x * a.f / (a.f - c.f) * b.f / (b.f - c.f);
}
inline double meets_zero(const PointOfFunction& a, const PointOfFunction& b) {
  return b.x - b.f * (b.x - a.x) / (b.f - a.f);
}

// As root_by_value, of a function that may be known before the root alone and near it: inverse quadratic
// interpolation, with a bisection where a step is not half of the one before the last (Brent, "Algorithms for
// minimization without derivatives", 1973, chapter 4). Beyond the root the function may be -infinity, which tells the
// side alone: as long as nothing else is known there, the bracket is cut to a small part of itself until a point before
// the root shows how fast the function falls; from then on lines through the last two such points alternate with
// bisections. Ends where |value| <= small, or where the bracket is narrower than width; the function has then been
// evaluated last at the root. value(x, fx) sets fx, and is false where the function cannot be evaluated: the search
// then ends with false, but for a first time while the bracket is cut, after which it is halved: what is found by going
// on from the last point may not be found so far from it.
template <class Value>
bool root_from_before(double low_value, double high, double high_value, double small, double width, int max_evaluations,
                      Value value, double& root) {
  double part = 1.0 / 32;  // of the bracket: roots are as likely in each octave
  PointOfFunction a{0.0, low_value}, b{high, high_value}, other{kNaN, kNaN};  // other: known before, outside of [a, b]
  double last = high, step = INFINITY, before = INFINITY;  // last point, last step between points, the one before
  bool missed = false;                                     // a line through points before the root led beyond it
  root = high;
  for (int k = 0; k < max_evaluations && b.x - a.x > width; ++k) {
    const bool known = std::isfinite(b.f), line = !known && other.f > a.f && !missed;
    double x = kNaN;
    if (known) {
      x = meets_zero(a, b, other);
      if (!(x > a.x && x < b.x)) x = meets_zero(a, b);
      if (!(std::abs(x - last) < 0.5 * before)) x = kNaN;
    } else if (line) {
      x = meets_zero(other, a);
    } else if (!(other.f > a.f)) {
      x = a.x + part * (b.x - a.x);
    }
    if (!(x > a.x && x < b.x)) x = 0.5 * (a.x + b.x);
    // What lies at one end by rounding is moved away from it: it shows on which side the root lies.
    x = std::clamp(x, a.x + 0.5 * width, b.x - 0.5 * width);
    double fx = 0.0;
    if (!value(x, fx)) {
      if (known || part == 0.5) return false;
      part = 0.5;
      missed = line;
      continue;
    }
    root = x;
    if (std::abs(fx) <= small) return true;
    before = known ? step : INFINITY;
    step = std::abs(x - last);
    last = x;
    missed = line && !std::isfinite(fx);
    PointOfFunction& end = fx < 0.0 ? b : a;
    if (std::isfinite(end.f)) other = end;
    end = {x, fx};
  }
  root = b.x;
  double fx = 0.0;
  return value(root, fx);
}

// Largest x in [0, 1] for which a condition holds that is true at 0 and false beyond some x: bisection to width, from
// x = 1. test(x, holds) sets holds, and is false where the condition cannot be evaluated: the search then ends with
// false. The condition has been tested last at the x that is returned.
template <class Test>
bool largest_where(double width, int max_evaluations, Test test, double& x) {
  double low = 0.0, high = 1.0;
  x = 1.0;
  for (int k = 0; k < max_evaluations; ++k) {
    bool holds = false;
    if (!test(x, holds)) return false;
    if (k == 0 && holds) break;
    (holds ? low : high) = x;
    if (holds && high - low < width) break;
    x = high - low < width ? low : 0.5 * (low + high);
  }
  return true;
}

}  // namespace contactvi

// Bracketed roots of scalar functions: each method keeps an interval in which the sign changes, so none can run away.
//
// Which one fits depends on what a function can tell: its value, its value and rate, or only on which side it is.
#pragma once

#include <algorithm>
#include <cmath>

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
// bisection every eighth time. Beyond the root the function may be -infinity, which tells the side alone: as long as
// nothing else is known there, lines through the last two points before the root alternate with bisections. Ends where
// |value| <= small, or where the bracket is narrower than width; the function has then been evaluated last at the
// root. value(x, fx) sets fx, and is false where the function cannot be evaluated: the search then ends with false.
template <class Value>
bool root_by_value(double low_value, double high, double high_value, double small, double width, int max_evaluations,
                   Value value, double& root) {
  double a = 0.0, b = high, fa = low_value, fb = high_value;
  double before = 0.0, f_before = low_value;  // the point on the side of a that was known before it
  root = high;
  int side = 0;
  for (int k = 0; k < max_evaluations && b - a > width; ++k) {
    const bool known = std::isfinite(fb);
    double x = 0.5 * (a + b);
    if (known && fa > fb && k % 8 != 7) x = b - fb * (b - a) / (fb - fa);
    if (!known && f_before > fa && k % 2 == 1) x = a + fa * (a - before) / (f_before - fa);
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
      before = a;
      f_before = fa;
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

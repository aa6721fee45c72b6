#include "event/gap_path.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/root.hpp"
#include "base/tolerances.hpp"

namespace contactvi {

namespace {

constexpr double kRootTarget = 1e-15;         // [m; rad] gap at which a root on the path is found
constexpr double kSmooth = 1.0 / 16;          // longest smooth part of the step,
constexpr double kTurn = 0.15;                // [rad] in which both bodies together turn by no more
constexpr double kFinest = 1.0 / (1L << 24);  // least part of the step in the search for a dip
constexpr int kMaxIterations = 60;
// Of the motion in the step: an interval with a larger gap at an end is clear, and one whose ends are not has none that
// is larger inside. So how much larger they are does not count.
constexpr double kFar = 2.0;

bool is_dip(const GapPath::Point& a, const GapPath::Point& b) { return a.rate < 0.0 && b.rate >= 0.0; }

// Least gap between a and b: where the tangents of a convex gap, which lies above them, meet; else at the lower end.
double lowest(const GapPath::Point& a, const GapPath::Point& b) {
  const double ends = std::min(a.gap, b.gap);
  if (!is_dip(a, b)) return ends;
  const double width = b.tau - a.tau;
  const double meet = (b.gap - a.gap - width * b.rate) / (width * (a.rate - b.rate));
  return meet > 0.0 && meet < 1.0 ? a.gap + width * a.rate * meet : ends;
}

// The least between two ends a and b of what bends by no more than `bend`: it lies below its chord by at most
// bend s (1 - s) / 2. So does the least of many such, since each lies above the chord of their least at the ends but
// for that.
double below_chord(double a, double b, double bend) {
  const double half = 0.5 * bend, rise = b - a;
  if (!(std::abs(rise) < half)) return std::min(a, b);
  return a - 0.25 * (half - rise) * (half - rise) / half;
}

}  // namespace

GapPath::GapPath(Guards& guards)
    : guards_(&guards),
      q_(guards.scene().tree.nq),
      v_(VecX::Zero(guards.scene().tree.nv)),
      W_(guards.scene().tree.nv),
      bend_(guards.scene().tree.nv) {
  joints_.reserve(2 * guards.scene().tree.joints.size());
}

void GapPath::set(const StepPath& path) {
  path_ = &path;
  q_ = path.q0();
  path.bend(bend_);
  guards_->bound_bend(bend_, path.h());
}

double GapPath::rate(int guard, double tau, const VecX& W) {
  guards_->list_joints(guard, joints_);
  path_->velocity(tau, joints_, v_);
  const double rate = path_->h() * W.dot(v_);
  const Tree& tree = guards_->scene().tree;
  for (int j : joints_) v_.segment(tree.joints[j].iv, tree.joints[j].nv).setZero();
  return rate;
}

GapPath::Point GapPath::at(int guard, double tau) {
  guards_->list_joints(guard, joints_);
  path_->configuration(tau, joints_, q_);
  guards_->place(q_);
  const double gap = guards_->evaluate(guard, contact_, enough(guard));
  if (!std::isfinite(gap)) return {tau, gap, gap};
  guards_->gradient(guard, contact_, W_);
  return {tau, gap, rate(guard, tau, W_)};
}

// Where features may appear at any gap no longer interval is clear than the smooth ones.
double GapPath::enough(int guard) const {
  const double part = guards_->gap_may_jump(guard) ? smooth_width(guard) : 1.0;
  return kFar * part * guards_->motion(guard);
}

GapPath::Point GapPath::at_with_direction(int guard, double tau) {
  Point point = at(guard, tau);
  look_along(guard, contact_, point);
  return point;
}

void GapPath::look_along(int guard, const Contact& contact, Point& point) {
  if (guards_->is_along_one_direction(guard)) {
    point.along = point.gap;
  } else if (guards_->has_gap_along(guard) && point.gap > 0.0) {
    point.direction = guards_->direction(guard, contact);
    point.along = guards_->gap_along(guard, point.direction);
  }
}

double GapPath::doubt(int guard, double tau) const {
  // The error has zeros of order two or more at both ends, so a straight line from there bounds it.
  const double weight = std::min(1.0, 8.0 * std::min(tau, 1.0 - tau));
  return weight * guards_->doubt(guard);
}

double GapPath::smooth_width(int guard) const {
  const double turn = guards_->turn(guard);
  return turn * kSmooth > kTurn ? kTurn / turn : kSmooth;
}

double GapPath::along(int guard, double tau, const Vec3& direction) {
  guards_->list_joints(guard, joints_);
  path_->configuration(tau, joints_, q_);
  guards_->place(q_);
  return guards_->gap_along(guard, direction);
}

double GapPath::least_between(int guard, double a, double b, double width) const {
  return below_chord(a, b, width * width * guards_->bend(guard)) - guards_->doubt(guard);
}

// No partial step lets a persistent point go deeper than what gaps are kept to, and the others turn about it.
double GapPath::least_in_step(int guard, double start, double end, bool held) const {
  const double least = least_between(guard, start, end, 1.0);
  if (!held) return least;
  return std::max(least, below_chord(start, end, guards_->bend_about_points(guard)) -
                             guards_->doubt_about_points(guard) - 2.0 * guards_->promised(guard));
}

bool GapPath::others_stay_open(int guard) {
  if (!guards_->is_persistent(guard)) return false;
  guards_->list_joints(guard, joints_);
  const auto place = [&](double tau) {
    path_->configuration(tau, joints_, q_);
    guards_->place(q_);
  };
  place(1.0);
  // The sine changes by no more than the bodies turn.
  const double crossing = guards_->crossing_of_points(guard) - guards_->turn(guard);
  if (!(crossing > 0.0)) return false;
  const double dip = guards_->dip_of_others(guard, crossing);
  if (!guards_->others_behind(guard, dip)) return false;
  place(0.0);
  return guards_->others_behind(guard, dip);
}

// Between the ends a convex gap lies above its tangents and a concave one above its chord. What turns it from the one
// to the other is the rotation of the bodies, which changes its rate by less than the motion times the angle. Or its
// ends add up to more than the motion, as in search(). A surface given by a function may rise and fall anywhere.
bool GapPath::plainly_clear(int guard, const Point& start, double end_gap) {
  if (start.gap + end_gap > guards_->motion(guard) && !guards_->gap_may_jump(guard)) return true;
  const double turn = guards_->turn(guard);
  const double unsure = 2.0 * guards_->doubt(guard) + turn * guards_->motion(guard);
  return turn <= kTurn && std::min(start.gap, end_gap) > unsure && !guards_->scene().has_surface(guard) &&
         lowest(start, at(guard, 1.0)) > unsure;
}

GapPath::Course GapPath::first(int guard, const Point& from, const Point& to, Point& lo, Point& hi) {
  return search(guard, from, to, std::numeric_limits<double>::infinity(), lo, hi);
}

// Whether distances along the direction of `known` show that the gap is positive from there to where the bodies are
// placed.
bool GapPath::stays_open(int guard, const Point& known, const Point& here) {
  if (!(std::min(known.along, here.gap) > 0.0)) return false;
  const double along = guards_->is_along_one_direction(guard) ? here.gap : guards_->gap_along(guard, known.direction);
  return least_between(guard, known.along, along, std::abs(here.tau - known.tau)) > 0.0;
}

// mismatch: distance of the gap from the cubic at the middle of the interval of which [a, b] is one half.
GapPath::Course GapPath::search(int guard, const Point& a, const Point& b, double mismatch, Point& lo, Point& hi) {
  const double width = b.tau - a.tau;
  if (!std::isfinite(a.gap) || !std::isfinite(b.gap)) return Course::kFailed;
  const bool bounded = b.gap > 0.0 && a.gap + b.gap > guards_->motion(guard) * width;
  if (bounded && !(guards_->gap_may_jump(guard) && width > smooth_width(guard))) return Course::kClear;
  const bool smooth = width <= smooth_width(guard), finest = width <= kFinest;
  if (smooth) {
    lo = a;
    hi = b;
    if (b.gap <= 0.0) return Course::kCrossing;
    const bool dip = is_dip(a, b);
    const double least = lowest(a, b);
    const double unsure = dip ? std::max(doubt(guard, a.tau), doubt(guard, b.tau)) : 0.0;
    if (least > mismatch + unsure) return Course::kClear;
    if (dip && (finest || (least <= unsure && mismatch <= unsure))) return Course::kDoubtful;
    if (finest) return Course::kClear;
  }
  const double mid = 0.5 * (a.tau + b.tau);
  if (!(mid > a.tau && mid < b.tau)) return b.gap <= 0.0 ? Course::kCrossing : Course::kClear;
  const Point m = at_with_direction(guard, mid);
  const bool left_open = stays_open(guard, a, m), right_open = stays_open(guard, b, m);
  const double cubic = 0.5 * (a.gap + b.gap) + 0.125 * width * (a.rate - b.rate);
  const double off = std::abs(m.gap - cubic);
  const Course left = left_open ? Course::kClear : search(guard, a, m, off, lo, hi);
  if (left != Course::kClear || right_open) return left;
  return search(guard, m, b, off, lo, hi);
}

double GapPath::root(int guard, Point lo, Point hi, double offset) {
  const double drop = lo.gap - hi.gap, width = hi.tau - lo.tau;
  const double start = drop > 0.0 ? lo.tau + width * std::clamp((lo.gap + offset) / drop, 0.0, 1.0) : hi.tau;
  return root_by_rate(lo.tau, hi.tau, start, kRootTarget, kMaxIterations, [&](double tau) {
    const Point p = at(guard, tau);
    return ValueAndRate{p.gap + offset, p.rate};
  });
}

double GapPath::minimum(int guard, Point a, Point b, double slope) {
  if (a.rate + slope >= 0.0) return a.tau;
  if (b.rate + slope <= 0.0) return b.tau;
  for (int k = 0; k < kMaxIterations; ++k) {
    const double width = b.tau - a.tau;
    // Neither end is higher above the minimum than this bound.
    if (std::max(-a.rate - slope, b.rate + slope) * width < kRootTarget || width < kSamePlaceInStep) break;
    const double secant = a.tau - width * (a.rate + slope) / (b.rate - a.rate);
    const bool inside = secant > a.tau && secant < b.tau && k % 3 != 2;
    const Point p = at(guard, inside ? secant : 0.5 * (a.tau + b.tau));
    const double rate = p.rate + slope;
    if (!(rate * rate * width > kRootTarget * (b.rate - a.rate))) return p.tau;
    (rate < 0.0 ? a : b) = p;
  }
  return a.gap + slope * a.tau < b.gap + slope * b.tau ? a.tau : b.tau;
}

}  // namespace contactvi

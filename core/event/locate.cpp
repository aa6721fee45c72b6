// EventFinder on the exact path, by partial steps, each of which costs as much as a step.
#include <algorithm>
#include <cmath>
#include <limits>

#include "base/tolerances.hpp"
#include "event/finder.hpp"

namespace contactvi {

namespace {
constexpr double kEventTarget = 1e-13;   // [m; rad] gap at which an event is located
constexpr double kClosing = 1e-12;       // [m; rad] a touching guard deeper than this has closed again
constexpr double kFlightHeight = 1e-16;  // [m; rad] a lower flight is rounding
constexpr double kBeyond = 1.001;        // fraction of the step up to which an event at its end may seem to lie
constexpr double kLeastPart = 1e-15;     // of the step: shorter parts are not cut further
constexpr int kMaxCuts = 1000;           // of the step, in the search for where a touching guard separates
constexpr int kMaxProbes = 80;           // exact partial steps to one event, or along a guard that touches
constexpr int kMaxDipProbes = 12;        // exact partial steps to one minimum
}  // namespace

bool EventFinder::exact_at(int guard, double tau, Point& point) {
  event_.q = *q0_;
  event_.p = *p0_;
  if (tau > 0.0) {  // the minimum of a gap may lie at the start, to which no step leads
    if (!stepper_->solve_part(*path_, tau, *q0_, *p0_, *tau_)) {
      // Where the path gives no good start values solve() tries others. Those of the steps taken must not be among
      // them: their polynomial ends where the whole step began.
      stepper_->forget();
      if (!stepper_->solve(*q0_, *p0_, tau * h_, *tau_)) return false;
    }
    stepper_->finish(event_.q, event_.p);
  }
  guards_->place(event_.q);
  point = {tau, guards_->evaluate(guard, contact_), 0.0};
  guards_->gradient(guard, contact_, W_);
  point.rate = gaps_.rate(guard, tau, W_);
  return true;
}

// The guards are placed at the event.
Search EventFinder::accept(int guard, const Point& at, bool stays_closed) {
  event_.guard = guard;
  event_.alpha = std::min(1.0, at.tau);
  event_.gap = at.gap;
  event_.stays_closed = stays_closed;
  return Search::kFound;
}

// Follows a touching guard from its start a: to where it has separated, or to where it closes without having done so.
Search EventFinder::separate_touching(Suspect& s, Point a) {
  const int g = s.guard;
  const double tolerance = Guards::kTouching;
  double width = gaps_.smooth_width(g);
  bool closes = false;
  int probes = 0;
  for (int k = 0; k < kMaxCuts && probes < kMaxProbes; ++k) {
    Point m = gaps_.at(g, std::min(1.0, a.tau + width));
    if (m.tau == 1.0) m.gap = s.end.gap;
    const double unsure = gaps_.doubt(g, m.tau);
    const bool probe = m.gap < -kClosing && m.gap > -kClosing - unsure;
    if (probe && !exact_at(g, m.tau, m)) return fail(Search::kNewtonFailed, g, 0);
    probes += probe ? 1 : 0;
    if (!std::isfinite(m.gap)) return fail(Search::kUnresolved, g, m.gap);
    const double used = m.tau - a.tau, grown = m.gap - a.gap, expected = used * std::max(a.rate, 0.0);
    if (m.gap > (closes ? 0.0 : tolerance) && grown >= 0.25 * expected) {
      // It rises as its first rate let expect. If that was negative its depth in between decides.
      const double curve = (grown - a.rate * used) / (used * used);
      s.from = m;
      if (a.rate >= 0.0) return Search::kNone;
      const Point low = gaps_.at(g, a.tau - 0.5 * a.rate / curve);
      return low.gap < -kClosing - gaps_.doubt(g, low.tau) ? close(s, a, low) : Search::kNone;
    }
    if (m.gap < -kClosing) {
      closes = true;
      const double curve = (expected - grown) / (used * used);
      const double height = 0.25 * a.rate * a.rate / curve;
      if (a.rate <= 0.0 || height < kFlightHeight || used < kLeastPart) return close(s, a, m);
      width = std::clamp(0.5 * a.rate / curve, 1e-3 * used, 0.5 * used);
    } else if (!closes && m.gap <= tolerance && expected <= 4.0 * tolerance) {
      if (m.tau == 1.0) {
        s.from = m;
        return Search::kNone;  // it touches throughout
      }
      a = m;
      width = gaps_.smooth_width(g);
    } else {
      width = 0.5 * used;  // it separated and came back
      if (used < kLeastPart) return close(s, a, m);
    }
  }
  // It stays about zero without separating or closing: it counts as closed, and the contact laws decide.
  s.crosses = s.stays_closed = true;
  s.root = 0.0;
  return Search::kNone;
}

// Enters the closing of a touching guard that is at a, and below zero at below, without having separated.
Search EventFinder::close(Suspect& s, const Point& a, const Point& below) {
  if (a.gap > 0.0) {
    cross(s, a, below, 0.0);  // an ordinary crossing
    return Search::kNone;
  }
  s.crosses = s.stays_closed = true;
  s.root = 0.0;
  return Search::kNone;
}

// Decides whether the exact gap dips below zero near [a, b], where that of the path has its minimum. The difference of
// the two is approximated linearly, through the probes so far.
Search EventFinder::exact_dip(Suspect& s, const Point& a, const Point& b) {
  const int g = s.guard;
  const double width = b.tau - a.tau, bend = (b.rate - a.rate) / width, tolerance = Guards::kRoot;
  const Point left = gaps_.at(g, std::max(s.from.tau, a.tau - width));
  const Point right = gaps_.at(g, std::min(1.0, b.tau + width));
  double x = gaps_.minimum(g, left, right, 0.0), slope = 0.0, last_slope = 0.0, last_x = x, last_offset = 0.0;
  for (int k = 0; k < kMaxDipProbes; ++k) {
    Point p;
    if (!exact_at(g, x, p)) return fail(Search::kNewtonFailed, g, 0);
    if (!std::isfinite(p.gap)) return fail(Search::kUnresolved, g, p.gap);
    const double offset = p.gap - gaps_.at(g, x).gap, above = p.gap + tolerance;
    if (above < 0.0) {
      const Point& lo = left.tau < x && left.gap + offset > 0.0 ? left : s.from;
      cross(s, lo, {x, p.gap - offset, p.rate}, offset);
      s.hi_sure = true;
      return Search::kNone;
    }
    double next;
    if (k == 0) {
      // Bound on the slope of the difference, which may move the minimum from x and lower it.
      const double steep = 8.0 * std::max(guards_->doubt(g), std::abs(offset));
      if (!(bend > 0.0) || above > 0.5 * steep * steep / bend) return Search::kNone;
      const double probe = std::min(std::sqrt(2.0 * above / bend), 0.5 * width);
      next = x + probe <= right.tau ? x + probe : x - probe;
    } else {
      slope = (offset - last_offset) / (x - last_x);
      next = gaps_.minimum(g, left, right, slope);
      const double predicted = gaps_.at(g, next).gap + offset + slope * (next - x), change = slope - last_slope;
      // Even with an error of the slope as large as its last change the minimum is not below zero.
      if (p.gap - predicted + 0.5 * change * change / bend < 0.5 * above) return Search::kNone;
      last_slope = slope;
    }
    last_x = x;
    last_offset = offset;
    if (!(std::abs(next - x) > kSamePlaceInStep)) return Search::kNone;
    x = next;
  }
  return Search::kNone;
}

// Goes on from a place where the exact gap is still positive although the path has crossed zero, to where the path's
// sign is sure again.
Search EventFinder::resume(Suspect& s, const Point& from) {
  const int g = s.guard;
  const double step = std::max(0.25 * (s.hi.tau - s.lo.tau), 1e-6);
  const Point before = s.lo;
  s.crosses = false;
  s.from = before;
  for (double tau = from.tau; tau < 1.0;) {
    tau = std::min(1.0, tau + step);
    Point p = gaps_.at(g, tau);
    if (tau == 1.0) p.gap = s.end.gap;
    if (p.gap <= (tau == 1.0 ? 0.0 : -gaps_.doubt(g, tau))) {
      cross(s, from, p, 0.0);
      s.lo_sure = s.hi_sure = true;
      return Search::kNone;
    }
    if (p.gap <= 0.0) continue;
    const Search outcome = exact_dip(s, before, p);
    if (!s.crosses) s.from = p;
    return outcome;
  }
  return Search::kNone;
}

// Locates the suspect's crossing. On kFound event() is filled, or exists is false: then the suspect is searched
// further.
Search EventFinder::locate(Suspect& s, bool& exists) {
  if (s.stays_closed) {
    event_.q = *q0_;
    event_.p = *p0_;
    guards_->place(event_.q);
    return accept(s.guard, {0.0, guards_->evaluate(s.guard, contact_), 0.0}, true);
  }
  const bool probe = !s.lo_sure;
  if (probe) {
    const Search outcome = find_open(s);
    if (outcome != Search::kNone || s.stays_closed) return outcome;
  }
  return polish(s, probe || s.lo.tau == 0.0, exists);
}

// Finds a point on the exact path before the crossing where the gap is positive.
Search EventFinder::find_open(Suspect& s) {
  s.lo_sure = true;
  if (!memory_.touching[s.guard]) {
    s.lo = {0.0, 0.0, 0.0};
    return Search::kNone;
  }
  for (double tau = s.lo.tau; tau > kLeastPart; tau *= 0.5) {
    if (!exact_at(s.guard, tau, s.lo)) return fail(Search::kNewtonFailed, s.guard, 0);
    if (s.lo.gap > 0.0) return Search::kNone;
    s.hi = s.lo;
    s.hi_sure = true;
  }
  // There is none, since it never separated.
  s.stays_closed = true;
  bool exists = true;
  return locate(s, exists);
}

// Iterates to the root on the exact path. lo_seen: the gap at s.lo is positive on the exact path.
Search EventFinder::polish(Suspect& s, bool lo_seen, bool& exists) {
  const int g = s.guard;
  const double tolerance = Guards::kRoot;
  double lo = s.lo.tau, hi = s.hi.tau, x = s.root > lo && s.root <= hi ? s.root : 0.5 * (lo + hi);
  Point p{}, before{0.0, std::numeric_limits<double>::infinity(), 0.0};
  for (int k = 0; k < kMaxProbes; ++k) {
    if (!exact_at(g, x, p)) return fail(Search::kNewtonFailed, g, 0);
    if (!std::isfinite(p.gap)) return fail(Search::kUnresolved, g, p.gap);
    const double size = std::abs(p.gap);
    if (size <= kEventTarget || (size <= tolerance && size > 0.25 * std::abs(before.gap))) return accept(g, p, false);
    if (p.gap > 0.0 && !s.hi_sure && (x >= hi || p.rate >= 0.0)) {
      exists = false;
      const Search outcome = resume(s, p);
      return outcome == Search::kNone ? Search::kFound : outcome;
    }
    // The whole step was solved from other start values: at its end the two solutions agree to the solver's tolerance.
    if (p.gap > 0.0 && x >= hi && hi == 1.0) hi = kBeyond;
    (p.gap > 0.0 ? lo : hi) = x;
    (p.gap > 0.0 ? lo_seen : s.hi_sure) = true;
    // Newton's method with the rate of the path at first, then secants, whose rate is exact.
    const double secant = (p.gap - before.gap) / (x - before.tau);
    double next = x - p.gap / (k > 0 && secant < 0.0 ? secant : p.rate);
    if (next <= lo && !lo_seen) {
      s.lo_sure = false;  // the path's error was larger than its bound
      s.hi = p;
      s.root = x;
      return locate(s, exists);
    }
    if (next >= hi && !s.hi_sure) {
      next = hi;
    } else if (!(next > lo && next < hi) || k % 8 == 7) {
      next = 0.5 * (lo + hi);
    }
    if (next == x || hi - lo <= kNarrowestBracket * hi) break;
    before = p;
    x = next;
  }
  // Where the closest feature of a pair changes, its gap jumps by rounding.
  const bool jumps = hi - lo <= kSamePlaceInStep * hi && std::abs(p.gap) <= kFeatureRounding;
  return std::abs(p.gap) <= tolerance || jumps ? accept(g, p, false) : fail(Search::kUnresolved, g, p.gap);
}

}  // namespace contactvi

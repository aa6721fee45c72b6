#include "event.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {
constexpr double kTarget = 1e-14;      // a gap at which nothing is left to improve
constexpr double kAccept = 1e-12;      // the promise
constexpr double kAcceptNoisy = 1e-9;  // where the collision library's own noise is larger
constexpr double kClosing = 1e-12;     // a touching guard below -this has closed again
constexpr int kMaxDepth = 24;          // of bisection in the search for a dip
constexpr int kSmoothDepth = 6;        // from here on a cubic through gaps and rates may rule a dip out
}  // namespace

EventFinder::EventFinder(const Scene& scene, Integrator& integrator, Guards& guards)
    : scene_(&scene),
      integrator_(&integrator),
      guards_(&guards),
      touching_(guards.count(), 0),
      q_(scene.tree.nq),
      p_(scene.tree.nv),
      v_(scene.tree.nv),
      v0_(scene.tree.nv),
      bound_(scene.tree.nv),
      guess_(scene.tree.nv),
      W_(scene.tree.nv) {
  active_.reserve(guards.count());
  pass_.reserve(guards.count());
  candidates_.reserve(guards.count());
  event_.q.resize(scene.tree.nq);
  event_.p.resize(scene.tree.nv);
}

Search EventFinder::fail(Search why, int guard, double gap) {
  failed_guard_ = guard;
  failed_gap_ = gap;
  return why;
}

bool EventFinder::start_velocity() {
  if (have_v0_) return true;
  have_v0_ = integrator_->node_velocity(*q0_, *p0_, v0_);
  return have_v0_;
}

double EventFinder::model_gap(int guard, double alpha) {
  v_ = v0_ + alpha * (*v1_ - v0_);
  integrate(scene_->tree, *q0_, v_, alpha * h_, q_);
  guards_->place(q_);
  return guards_->evaluate(guard, contact_);
}

bool EventFinder::exact_gap(int guard, double alpha, double& gap) {
  guess_ = v0_ + alpha * (*v1_ - v0_);
  if (!integrator_->solve(*q0_, *p0_, guess_, alpha * h_, *tau_)) return false;
  integrator_->finish(*q0_, *p0_, alpha * h_, event_.q, event_.p);
  --integrator_->counters.steps;  // a probe, not a step
  guards_->place(event_.q);
  gap = guards_->evaluate(guard, contact_);
  return true;
}

double EventFinder::gap_rate(int guard) {
  // Velocity at the end of the partial step: 2 v - v0 up to O(h^2), good enough for a Newton slope.
  guards_->gradient(guard, contact_, W_);
  return h_ * (2 * W_.dot(integrator_->v()) - W_.dot(v0_));
}

Search EventFinder::search(const VecX& q0, const VecX& p0, const VecX& v1, const VecX& q1, double h, const VecX& tau,
                           const VecX* previous) {
  q0_ = &q0;
  p0_ = &p0;
  v1_ = &v1;
  tau_ = &tau;
  h_ = h;
  have_v0_ = false;
  active_.clear();
  pass_.clear();
  candidates_.clear();
  // Velocities along the step reach from v0 to 2 v1 - v0; with a neighbour step v0 = (previous + v1)/2 up to O(h^2).
  if (previous != nullptr) {
    bound_ = v1.cwiseAbs() + (v1 - *previous).cwiseAbs();
  } else {
    if (!start_velocity()) return fail(Search::kNewtonFailed, -1, 0);
    bound_ = v1.cwiseAbs() + 2 * (v1 - v0_).cwiseAbs();
  }
  guards_->bound_motion(q0, bound_, h);
  guards_->place(q1);
  for (int g = 0; g < guards_->count(); ++g) {
    if (!touching_[g] && guards_->skip(g)) {
      ++guards_->counters.skipped;
      continue;
    }
    pass_.push_back(g);
    if (!touching_[g] && guards_->separated_at_end(g)) {
      ++guards_->counters.skipped;
      continue;
    }
    Contact at_end;
    const double gap = guards_->evaluate(g, at_end);
    if (!std::isfinite(gap)) return fail(Search::kUnresolved, g, gap);
    if (!touching_[g] && gap > guards_->motion(g)) {
      guards_->mark(g, gap);
      continue;
    }
    active_.push_back(g);
    candidates_.push_back({g, 0.0, 1.0, gap, touching_[g] != 0});  // estimate holds the end gap until check()
  }
  const std::vector<Candidate> suspects = candidates_;
  candidates_.clear();
  for (const Candidate& suspect : suspects) {
    const double end_gap = suspect.estimate;
    failed_gap_ = end_gap;
    const Search outcome = touching_[suspect.guard] ? check_touching(suspect.guard) : check(suspect.guard);
    if (outcome == Search::kNewtonFailed || outcome == Search::kUnresolved) return outcome;
  }
  while (!candidates_.empty()) {
    const auto first = std::min_element(candidates_.begin(), candidates_.end(),
                                        [](const Candidate& a, const Candidate& b) { return a.estimate < b.estimate; });
    Candidate candidate = *first;
    candidates_.erase(first);
    bool exists = false;
    const Search outcome = locate(candidate, exists);
    if (outcome != Search::kFound) return outcome;
    if (!exists) continue;
    // Another candidate already below zero there comes earlier; then this one is no longer the first.
    bool earlier = false;
    for (Candidate& other : candidates_) {
      Contact contact;
      if (other.lo >= event_.alpha || guards_->evaluate(other.guard, contact) >= -guards_->touch_tolerance(other.guard))
        continue;
      other.hi = event_.alpha;
      if (other.estimate >= other.hi) other.estimate = 0.5 * (other.lo + other.hi);
      earlier = true;
    }
    if (earlier) continue;
    for (int g : pass_) guards_->unmark(g);  // their marks are for the end of the whole step
    guards_->commit();
    return Search::kFound;
  }
  for (std::size_t k = 0; k < suspects.size(); ++k) {
    const int g = suspects[k].guard;
    const double gap = suspects[k].estimate;
    if (touching_[g] && gap > guards_->touch_tolerance(g)) touching_[g] = 0;
    if (!touching_[g]) guards_->mark(g, gap);
  }
  guards_->commit();
  return Search::kNone;
}

Search EventFinder::check(int guard) {
  const double end_gap = failed_gap_;
  if (!start_velocity()) return fail(Search::kNewtonFailed, guard, 0);
  const double start_gap = model_gap(guard, 0.0);
  if (start_gap <= 0.0) {
    // Rounding: it touches although nothing hit it yet. Deeper is a contradiction.
    if (start_gap < -guards_->touch_tolerance(guard)) return fail(Search::kUnresolved, guard, start_gap);
    touching_[guard] = 1;
    failed_gap_ = end_gap;
    return check_touching(guard);
  }
  Candidate found{guard, 0.0, 1.0, 1.0, false};
  if (end_gap <= 0.0) {
    // The earliest crossing, not just one: look for it from the left.
    if (!find_dip(guard, 0.0, start_gap, 1.0, end_gap, 0, found)) found = {guard, 0.0, 1.0, 0.5, false};
    candidates_.push_back(found);
  } else if (find_dip(guard, 0.0, start_gap, 1.0, end_gap, 0, found)) {
    candidates_.push_back(found);
  }
  return Search::kNone;
}

Search EventFinder::check_touching(int guard) {
  const double end_gap = failed_gap_;
  if (end_gap >= -kClosing) {
    if (end_gap <= guards_->touch_tolerance(guard)) return Search::kNone;  // still touching
    if (!start_velocity()) return fail(Search::kNewtonFailed, guard, 0);
    // It separates; it may come back down inside of a long step.
    Candidate found{guard, 0.125, 1.0, 1.0, true};
    const double early = model_gap(guard, 0.125);
    if (early > 0.0 && find_dip(guard, 0.125, early, 1.0, end_gap, 3, found)) candidates_.push_back(found);
    return Search::kNone;
  }
  if (!start_velocity()) return fail(Search::kNewtonFailed, guard, 0);
  const double start_gap = model_gap(guard, 0.0);
  guards_->gradient(guard, contact_, W_);
  const double slope = h_ * W_.dot(v0_);
  if (start_gap > 0.0 && slope < 0.0) {
    candidates_.push_back(
        {guard, 0.0, 1.0, std::min(1.0, -start_gap / slope), false});  // closing again: an ordinary crossing
    return Search::kNone;
  }
  // gap(alpha) ~ start + slope alpha + curve alpha^2: back at zero near -slope/curve.
  const double curve = end_gap - start_gap - slope;
  const double back = slope > 0.0 && curve < 0.0 ? std::min(1.0, -slope / curve) : 0.0;
  candidates_.push_back({guard, 0.0, 1.0, back, true});
  return Search::kNone;
}

bool EventFinder::find_dip(int guard, double lo, double gap_lo, double hi, double gap_hi, int depth, Candidate& found) {
  const double reach = guards_->motion(guard) * (hi - lo);
  if (gap_hi > 0.0 && gap_lo + gap_hi > reach) return false;
  if (gap_hi <= 0.0 && depth >= kSmoothDepth) {
    found = {guard, lo, hi, lo + (hi - lo) * gap_lo / (gap_lo - gap_hi), found.touching};
    return true;
  }
  if (depth >= kMaxDepth) return false;
  if (gap_hi > 0.0 && depth >= kSmoothDepth) {
    // Cubic Hermite model of the gap: no interior minimum, or one clear of zero by its own third difference.
    const double width = hi - lo;
    model_gap(guard, lo);
    guards_->gradient(guard, contact_, W_);
    const double rate_lo = width * h_ * (W_.dot(v0_) + 2 * lo * (W_.dot(*v1_) - W_.dot(v0_)));
    if (rate_lo >= 0.0 && depth > kSmoothDepth) return false;
    model_gap(guard, hi);
    guards_->gradient(guard, contact_, W_);
    const double rate_hi = width * h_ * (W_.dot(v0_) + 2 * hi * (W_.dot(*v1_) - W_.dot(v0_)));
    // Tangents at both ends bound a convex gap from below; they meet above zero when there is no dip to it.
    if (rate_lo >= 0.0 || rate_hi <= 0.0) return false;
    const double meet = (gap_hi - gap_lo - rate_hi) / (rate_lo - rate_hi);
    if (meet > 0.0 && meet < 1.0 && gap_lo + rate_lo * meet > 0.0) return false;
  }
  const double mid = 0.5 * (lo + hi);
  const double gap_mid = model_gap(guard, mid);
  if (gap_mid <= 0.0) return find_dip(guard, lo, gap_lo, mid, gap_mid, depth + 1, found);
  if (find_dip(guard, lo, gap_lo, mid, gap_mid, depth + 1, found)) return true;
  return find_dip(guard, mid, gap_mid, hi, gap_hi, depth + 1, found);
}

Search EventFinder::locate(Candidate& c, bool& exists) {
  const int guard = c.guard;
  exists = true;
  double gap = 0, x = c.estimate;
  // lo is a point of the model path: on the exact path the root may lie O(h^3) before it, and only the start is certain.
  double lo = c.touching ? c.lo : 0.0, hi = c.hi;
  if (!exact_gap(guard, hi, gap)) return fail(Search::kNewtonFailed, guard, 0);
  if (gap > 0.0) {
    // The model path is ahead of the exact one by O(h^3): the crossing is later, or only the model grazes.
    lo = hi;
    hi = 1.0;
    if (lo < hi && !exact_gap(guard, hi, gap)) return fail(Search::kNewtonFailed, guard, 0);
    exists = gap <= 0.0;
    if (!exists) return Search::kFound;
    x = lo;
    c.touching = false;
  }
  if (c.touching && lo > 0.0) {
    if (!exact_gap(guard, lo, gap)) return fail(Search::kNewtonFailed, guard, 0);
    if (gap <= 0.0) {
      hi = lo;
      lo = 0.0;
    }
  }
  if (c.touching && lo == 0.0) {
    // Find a point where it has separated; if there is none it never did.
    lo = 0.5 * (x > 0.0 ? x : 0.0);
    bool separated = false;
    for (int k = 0; k < 50 && lo > 1e-15 && !separated; ++k) {
      if (!exact_gap(guard, lo, gap)) return fail(Search::kNewtonFailed, guard, 0);
      if (gap > 0.0) {
        separated = true;
      } else {
        hi = lo;
        lo *= 0.5;
      }
    }
    if (!separated) {
      event_.guard = guard;
      event_.alpha = 0.0;
      event_.persistent = true;
      event_.q = *q0_;
      event_.p = *p0_;
      guards_->place(event_.q);
      event_.gap = guards_->evaluate(guard, contact_);
      return Search::kFound;
    }
    if (!(x > lo && x < hi)) x = 0.5 * (lo + hi);
  }
  double best = INFINITY, best_x = x;
  for (int k = 0; k < 80; ++k) {
    if (!exact_gap(guard, x, gap)) return fail(Search::kNewtonFailed, guard, 0);
    if (!std::isfinite(gap)) return fail(Search::kUnresolved, guard, gap);
    if (std::abs(gap) < best) {
      best = std::abs(gap);
      best_x = x;
    }
    if (std::abs(gap) <= kTarget) break;
    (gap > 0.0 ? lo : hi) = x;
    const double next = x - gap / gap_rate(guard);
    const bool inside = next > lo && next < hi && k % 8 != 7;  // now and then a bisection, should Newton crawl
    const double moved = inside ? next : 0.5 * (lo + hi);
    if (moved == x || hi - lo <= 4e-16 * hi) break;
    x = moved;
    if (best <= kAccept && std::abs(gap) > 0.25 * best && k > 6) break;  // rounding floor
  }
  if (x != best_x || !(std::abs(gap) <= best)) {
    if (!exact_gap(guard, best_x, gap)) return fail(Search::kNewtonFailed, guard, 0);
  }
  const double accept = guards_->touch_tolerance(guard) > 1e-10 ? kAcceptNoisy : kAccept;
  if (!(std::abs(gap) <= accept)) return fail(Search::kUnresolved, guard, gap);
  event_.guard = guard;
  event_.alpha = best_x;
  event_.gap = gap;
  event_.persistent = false;
  return Search::kFound;
}

}  // namespace contactvi

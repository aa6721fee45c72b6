#include "event.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {
constexpr double kTarget = 1e-14;   // a gap at which nothing is left to improve
constexpr double kClosing = 1e-12;  // a touching guard below -this has closed again
constexpr int kMaxDepth = 24;       // of bisection in the search for a dip
constexpr int kSmoothDepth = 6;     // from here on a cubic through gaps and rates may rule a dip out
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
      bend_(VecX::Zero(scene.tree.nv)),
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

// v(alpha) through v0, the exact v(1/2) and v1: error O(h^4) of the path.
bool EventFinder::prepare_model() {
  if (have_bend_) return true;
  guess_ = 0.5 * (v0_ + *v1_);
  if (!integrator_->solve(*q0_, *p0_, guess_, 0.5 * h_, *tau_)) return false;
  bend_ = 4.0 * (guess_ - integrator_->v());
  // What the quadratic corrects is what a dip may still be wrong by, to be safe.
  const double size = bound_.cwiseAbs().maxCoeff();
  slack_ = size > 0.0 ? 0.25 * bend_.cwiseAbs().maxCoeff() / size : 0.0;
  have_bend_ = true;
  return true;
}

double EventFinder::model_gap(int guard, double alpha) {
  v_ = v0_ + alpha * (*v1_ - v0_) - alpha * (1.0 - alpha) * bend_;
  integrate(scene_->tree, *q0_, v_, alpha * h_, q_);
  guards_->place(q_);
  return guards_->evaluate(guard, contact_);
}

// d(gap)/d(alpha) on the model path, W_ being the gradient there: d/d(alpha) of alpha v(alpha).
double EventFinder::model_rate(double alpha) const {
  const double slope = W_.dot(*v1_) - W_.dot(v0_), bend = W_.dot(bend_);
  return h_ * (W_.dot(v0_) + 2 * alpha * slope - alpha * (2.0 - 3.0 * alpha) * bend);
}

bool EventFinder::exact_gap(int guard, double alpha, double& gap) {
  guess_ = v0_ + alpha * (*v1_ - v0_);
  if (have_bend_) guess_ -= alpha * (1.0 - alpha) * bend_;
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
  have_v0_ = have_bend_ = false;
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
    const Search outcome =
        touching_[suspect.guard] ? check_touching(suspect.guard, end_gap) : check(suspect.guard, end_gap);
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
      if (guards_->evaluate(other.guard, contact) >= -guards_->touch_tolerance(other.guard)) continue;
      if (other.lo >= event_.alpha) other.lo = 0.0;  // the model had it later
      other.hi = event_.alpha;
      if (other.estimate >= other.hi) other.estimate = 0.5 * (other.lo + other.hi);
      earlier = true;
    }
    // Nor may anything else be below zero there: a dip that the search did not see.
    for (int other : active_) {
      Contact contact;
      const bool known = other == candidate.guard || std::any_of(candidates_.begin(), candidates_.end(),
                                                                 [&](const Candidate& c) { return c.guard == other; });
      if (known || guards_->evaluate(other, contact) >= -guards_->touch_tolerance(other)) continue;
      candidates_.push_back({other, 0.0, event_.alpha, 0.5 * event_.alpha, touching_[other] != 0});
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

Search EventFinder::check(int guard, double end_gap) {
  if (!start_velocity() || !prepare_model()) return fail(Search::kNewtonFailed, guard, 0);
  const double start_gap = model_gap(guard, 0.0);
  if (start_gap <= 0.0) {
    // Rounding: it touches although nothing hit it yet. Deeper is a contradiction.
    if (start_gap < -guards_->touch_tolerance(guard)) return fail(Search::kUnresolved, guard, start_gap);
    touching_[guard] = 1;
    return check_touching(guard, end_gap);
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

Search EventFinder::check_touching(int guard, double end_gap) {
  if (end_gap >= -kClosing) {
    if (end_gap <= guards_->touch_tolerance(guard)) return Search::kNone;  // still touching
    if (!start_velocity() || !prepare_model()) return fail(Search::kNewtonFailed, guard, 0);
    // It separates; it may come back down inside of a long step.
    Candidate found{guard, 0.125, 1.0, 1.0, true};
    const double early = model_gap(guard, 0.125);
    if (early > 0.0 && find_dip(guard, 0.125, early, 1.0, end_gap, 3, found)) candidates_.push_back(found);
    return Search::kNone;
  }
  if (!start_velocity() || !prepare_model()) return fail(Search::kNewtonFailed, guard, 0);
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
    const double rate_lo = width * model_rate(lo);
    if (rate_lo >= 0.0 && depth > kSmoothDepth) return false;
    model_gap(guard, hi);
    guards_->gradient(guard, contact_, W_);
    const double rate_hi = width * model_rate(hi);
    // Tangents at both ends bound a convex gap from below; they meet above zero when there is no dip to it. Nearer to
    // zero than the model is true, the exact path decides.
    if (rate_lo >= 0.0 || rate_hi <= 0.0) return false;
    const double meet = (gap_hi - gap_lo - rate_hi) / (rate_lo - rate_hi);
    const double doubt = slack_ * guards_->motion(guard);
    if (meet > 0.0 && meet < 1.0 && gap_lo + rate_lo * meet > doubt) return false;
    if (std::min(gap_lo, gap_hi) <= doubt || depth > kSmoothDepth + 6) return exact_dip(guard, lo, hi, found);
  }
  const double mid = 0.5 * (lo + hi);
  const double gap_mid = model_gap(guard, mid);
  if (gap_mid <= 0.0) return find_dip(guard, lo, gap_lo, mid, gap_mid, depth + 1, found);
  if (find_dip(guard, lo, gap_lo, mid, gap_mid, depth + 1, found)) return true;
  return find_dip(guard, mid, gap_mid, hi, gap_hi, depth + 1, found);
}

// Minimum of the exact gap around [lo, hi], in which the model has one: true once the gap is not positive.
bool EventFinder::exact_dip(int guard, double lo, double hi, Candidate& found) {
  const double width = hi - lo;
  double left = std::max(0.0, lo - width), right = std::min(1.0, hi + width);
  const double start = left;
  double gap = 0.0;
  for (int k = 0; k < 60 && right - left > 1e-12; ++k) {
    const double mid = 0.5 * (left + right);
    if (!exact_gap(guard, mid, gap)) return false;
    if (gap <= 0.0) {
      found = {guard, start, mid, 0.5 * (start + mid), found.touching};
      return true;
    }
    const double rate = gap_rate(guard);
    (rate < 0.0 ? left : right) = mid;
    // At this rate the rest of the interval cannot reach zero, curvature included.
    if (gap > 4.0 * std::abs(rate) * (right - left)) return false;
  }
  return false;
}

Search EventFinder::locate(Candidate& c, bool& exists) {
  const int guard = c.guard;
  exists = true;
  double gap = 0, x = c.estimate;
  // lo is a point of the model path: on the exact path the root may lie O(h^3) before it, and only the start is
  // certain.
  double lo = c.touching ? c.lo : 0.0, hi = c.hi;
  // At the end of the step the search has seen the exact gap already.
  if (hi < 1.0 && !exact_gap(guard, hi, gap)) return fail(Search::kNewtonFailed, guard, 0);
  if (hi < 1.0 && gap > 0.0) {
    // The model path is ahead of the exact one by O(h^3): the crossing is later, or only the model grazes.
    lo = hi;
    hi = 1.0;
    if (!exact_gap(guard, hi, gap)) return fail(Search::kNewtonFailed, guard, 0);
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
    if (best <= guards_->root_tolerance(guard) && std::abs(gap) > 0.25 * best && k > 6) break;  // rounding floor
  }
  if (x != best_x || !(std::abs(gap) <= best)) {
    if (!exact_gap(guard, best_x, gap)) return fail(Search::kNewtonFailed, guard, 0);
  }
  if (!(std::abs(gap) <= guards_->root_tolerance(guard))) return fail(Search::kUnresolved, guard, gap);
  event_.guard = guard;
  event_.alpha = best_x;
  event_.gap = gap;
  event_.persistent = false;
  return Search::kFound;
}

}  // namespace contactvi

#include "event/finder.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {
constexpr std::size_t kClose = 16;  // candidates for the first event, from which on rounding may decide among them
}  // namespace

EventFinder::EventFinder(const Scene& scene, Stepper& stepper, Guards& guards)
    : scene_(&scene),
      stepper_(&stepper),
      guards_(&guards),
      gaps_(guards),
      touching_(guards.count(), 0),
      v0_(scene.tree.nv),
      v1_(scene.tree.nv),
      bound_(scene.tree.nv),
      doubt_(scene.tree.nv),
      W_(scene.tree.nv),
      last_rate_(scene.tree.nv),
      last_q_(scene.tree.nq),
      last_p_(scene.tree.nv) {
  active_.reserve(guards.count());
  pass_.reserve(guards.count());
  suspects_.reserve(guards.count());
  event_.q.resize(scene.tree.nq);
  event_.p.resize(scene.tree.nv);
}

Search EventFinder::fail(Search why, int guard, double gap) {
  for (int g : pass_) guards_->unmark(g);  // the step may be tried again, shorter
  last_h_ = 0.0;
  failed_guard_ = guard;
  failed_gap_ = gap;
  return why;
}

Search EventFinder::search(const VecX& q0, const VecX& p0, const VecX& q1, const VecX& p1, double h, const VecX& tau,
                           StepPath& path) {
  q0_ = &q0;
  p0_ = &p0;
  q1_ = &q1;
  p1_ = &p1;
  tau_ = &tau;
  path_ = &path;
  h_ = h;
  if (!bound_step()) return fail(Search::kNewtonFailed, -1, 0);
  guards_->bound_motion(q0, bound_, h);
  if (!collect()) return Search::kUnresolved;
  if (suspects_.empty()) {
    settle();
    return Search::kNone;
  }
  if (!raise_path()) return fail(Search::kNewtonFailed, -1, 0);
  if (bound_grows()) {
    guards_->bound_motion(q0, bound_, h);
    for (int g : pass_) guards_->unmark(g);
    if (!collect()) return Search::kUnresolved;
  }
  guards_->bound_doubt(q0, doubt_, h / (2 * path.stages() + 1));  // the integral of P_s is that much less than P_s
  gaps_.set(path);
  for (Suspect& s : suspects_) {
    const Search outcome = start(s);
    if (outcome != Search::kNone) return outcome;
  }
  for (std::size_t k = 0; k < 8 * suspects_.size() + 64; ++k) {
    Suspect* first = nullptr;
    Search outcome = find_first(first);
    if (outcome != Search::kNone) return outcome;
    if (first == nullptr) {
      settle();
      return Search::kNone;
    }
    bool exists = true;
    outcome = locate(*first, exists);
    if (outcome != Search::kFound) return outcome;
    if (!exists || someone_is_earlier(*first, k >= kClose)) continue;
    for (int g : pass_) guards_->unmark(g);  // their marks are for the end of the whole step
    guards_->commit();
    last_h_ = 0.0;
    return Search::kFound;
  }
  return fail(Search::kUnresolved, suspects_[0].guard, 0);
}

// Bound on the velocities of the exact path, from the polynomial and what it leaves out.
bool EventFinder::bound_step() {
  path_->bound(bound_);
  if (path_->stages() > 1) {
    path_->doubt(doubt_);
    bound_ += doubt_;
    return true;
  }
  // One stage knows the velocity of the middle only. They reach from v0 to 2 v - v0; with a neighbour step of equal
  // length v0 = (previous + v)/2 up to O(h^2).
  path_->chart_rate(0.5, v1_);
  if (last_h_ == h_ && last_p_ == *p0_ && last_q_ == *q0_) {
    W_ = v1_ - last_rate_;
    add_size(scene_->tree, W_, 1.0, bound_);
  } else {
    if (!stepper_->node_velocity(*q0_, *p0_, v0_)) return false;
    W_ = v1_ - v0_;
    add_size(scene_->tree, W_, 2.0, bound_);
  }
  last_rate_ = v1_;
  return true;
}

bool EventFinder::raise_path() {
  if (path_->raised()) return true;
  if (!stepper_->node_velocity(*q0_, *p0_, v0_)) return false;
  if (path_->stages() == 1) {
    if (!stepper_->solve_part(*path_, 0.5, *q0_, *p0_, *tau_)) return false;
    v1_ = stepper_->rates().col(0);
    path_->raise_by_half_step(v0_, v1_);
    return true;
  }
  if (!stepper_->node_velocity(*q1_, *p1_, v1_)) return false;
  path_->raise(v0_, v1_);
  return true;
}

// The raised path knows better; true if some velocity is larger than it was thought to be.
bool EventFinder::bound_grows() {
  path_->doubt(doubt_);
  path_->bound(W_);
  W_ += doubt_;
  const bool grows = (W_.array() > bound_.array()).any();
  bound_ = bound_.cwiseMax(W_);
  return grows;
}

// The guards that may reach zero in the step.
bool EventFinder::collect() {
  active_.clear();
  pass_.clear();
  suspects_.clear();
  guards_->place(*q1_);
  for (int g = 0; g < guards_->count(); ++g) {
    const auto exempted = std::find(exempt_.begin(), exempt_.end(), g);
    if (exempted != exempt_.end()) {
      if (guards_->evaluate(g, contact_) >= -guards_->depth_tolerance(g)) continue;
      exempt_.erase(exempted);  // it does not leave
    }
    if (!touching_[g] && guards_->skip(g)) {
      ++guards_->counters.skipped;
      continue;
    }
    pass_.push_back(g);
    if (!touching_[g] && guards_->separated_at_end(g)) {
      ++guards_->counters.skipped;
      continue;
    }
    const double gap = guards_->evaluate(g, contact_);
    if (!std::isfinite(gap)) {
      fail(Search::kUnresolved, g, gap);
      return false;
    }
    if (!touching_[g] && gap > guards_->motion(g)) {
      guards_->mark(g, gap);
      continue;
    }
    active_.push_back(g);
    const Point none{0.0, 0.0, 0.0};
    suspects_.push_back({g, gap, none, false, false, none, none, false, false, 0.0});
  }
  return true;
}

Search EventFinder::start(Suspect& s) {
  const Point a = gaps_.at(s.guard, 0.0);
  const double tolerance = guards_->touch_tolerance(s.guard);
  if (!std::isfinite(a.gap)) return fail(Search::kUnresolved, s.guard, a.gap);
  if (touching_[s.guard] && a.gap > tolerance) touching_[s.guard] = 0;
  if (!touching_[s.guard] && a.gap <= 0.0) {
    // Rounding: it touches although nothing hit it yet. Deeper is a contradiction.
    if (a.gap < -guards_->depth_tolerance(s.guard)) return fail(Search::kUnresolved, s.guard, a.gap);
    touching_[s.guard] = 1;
  }
  if (touching_[s.guard]) return leave(s, a);
  s.from = a;
  return Search::kNone;
}

// The suspect that crosses first on the path; none is followed further than to the first crossing so far.
Search EventFinder::find_first(Suspect*& first) {
  double limit = 1.0;
  for (Suspect& s : suspects_) {
    const Search outcome = advance(s, limit);
    if (outcome != Search::kNone) return outcome;
    if (!s.crosses || (first != nullptr && s.root >= first->root)) continue;
    first = &s;
    limit = s.root;
  }
  return Search::kNone;
}

Search EventFinder::advance(Suspect& s, double limit) {
  while (!s.crosses && s.from.tau < limit) {
    Point to = gaps_.at(s.guard, limit);
    if (limit == 1.0) to.gap = s.end_gap;
    Point lo{}, hi{};
    switch (gaps_.first(s.guard, s.from, to, lo, hi)) {
      case GapPath::Course::kClear:
        s.from = to;
        break;
      case GapPath::Course::kCrossing:
        cross(s, lo, hi, 0.0);
        break;
      case GapPath::Course::kDoubtful: {
        const Search outcome = exact_dip(s, lo, hi);
        if (outcome != Search::kNone) return outcome;
        if (!s.crosses) s.from = hi;
        break;
      }
      case GapPath::Course::kFailed:
        return fail(Search::kUnresolved, s.guard, to.gap);
    }
  }
  return Search::kNone;
}

// Its exact gap is offset more than that of the path. What is nearer to zero than the path is true is not sure.
void EventFinder::cross(Suspect& s, const Point& lo, const Point& hi, double offset) {
  s.crosses = true;
  s.lo = lo;
  s.hi = hi;
  s.lo_sure = lo.tau == 0.0 || lo.gap > gaps_.doubt(s.guard, lo.tau);
  s.hi_sure = (hi.tau == 1.0 && s.end_gap <= 0.0) || hi.gap < -gaps_.doubt(s.guard, hi.tau);
  s.root = gaps_.root(s.guard, lo, hi, offset);
}

// With the guards placed at the event: is another one below zero there? Then it crosses earlier, or the search did
// not see its dip.
bool EventFinder::someone_is_earlier(const Suspect& first, bool coarse) {
  const double alpha = event_.alpha;
  bool earlier = false;
  for (Suspect& s : suspects_) {
    if (&s == &first) continue;
    const double gap = guards_->evaluate(s.guard, contact_);
    if (gap >= -(coarse ? guards_->depth_tolerance(s.guard) : guards_->touch_tolerance(s.guard))) continue;
    earlier = true;
    const Point before = s.crosses ? s.lo : s.from;
    s.lo_sure = before.tau < alpha && before.gap > gaps_.doubt(s.guard, before.tau);
    s.lo = s.lo_sure ? before : Point{0.5 * alpha, 0.0, 0.0};
    s.hi = {alpha, gap, 0.0};
    s.hi_sure = s.crosses = true;
    s.root = alpha;
  }
  return earlier;
}

void EventFinder::cut() {
  for (int g : pass_) guards_->unmark(g);
  last_h_ = 0.0;
}

// Nothing happens in the step.
void EventFinder::settle() {
  exempt_.clear();
  for (const Suspect& s : suspects_) {
    if (s.end_gap > guards_->touch_tolerance(s.guard)) touching_[s.guard] = 0;
    if (!touching_[s.guard]) guards_->mark(s.guard, s.end_gap);
  }
  guards_->commit();
  last_h_ = h_;
  last_q_ = *q1_;
  last_p_ = *p1_;
}

}  // namespace contactvi

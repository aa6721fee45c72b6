#include "event/finder.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {
constexpr std::size_t kManyCandidates = 16;  // for the first event: from then on rounding may decide among them
constexpr int kUsualSuspects = 512;  // of a step: the workspace for them is made in advance, that for more on demand
}  // namespace

EventFinder::EventFinder(const Scene& scene, Stepper& stepper, Guards& guards)
    : scene_(&scene),
      stepper_(&stepper),
      guards_(&guards),
      gaps_(guards),
      v0_(scene.tree.nv),
      v1_(scene.tree.nv),
      bound_(scene.tree.nv),
      doubt_(scene.tree.nv),
      W_(scene.tree.nv),
      memory_{std::vector<char>(guards.count(), 0), {}, VecX(scene.tree.nv), VecX(scene.tree.nq), VecX(scene.tree.nv)} {
  const std::size_t usual = std::min(guards.count(), kUsualSuspects);
  active_.reserve(usual);
  pass_.reserve(usual);
  suspects_.reserve(usual);
  event_.q.resize(scene.tree.nq);
  event_.p.resize(scene.tree.nv);
}

Search EventFinder::fail(Search why, int guard, double gap) {
  for (int g : pass_) guards_->unmark(g);  // the step may be tried again, shorter
  memory_.h = 0.0;
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
  if (guards_->pass(bound_, h)) {
    forget_last();
    guards_->counters.skipped += guards_->count();
    remember();
    return Search::kNone;
  }
  guards_->bound_motion(q0, bound_, h);
  if (!collect()) return Search::kUnresolved;
  if (suspects_.empty()) {
    settle();
    return Search::kNone;
  }
  if (path.stages() == 1 && !path.raised()) {
    if (!stepper_->node_velocity(q0, p0, v0_)) return fail(Search::kNewtonFailed, -1, 0);
    path.lean(v0_);
    if (!bound_again()) return Search::kUnresolved;
    if (plainly_clear()) {
      settle();
      return Search::kNone;
    }
  }
  if (!raise_path()) return fail(Search::kNewtonFailed, -1, 0);
  if (!bound_again()) return Search::kUnresolved;
  guards_->bound_doubt(doubt_, h / (2 * path.stages() + 1));  // the integral of P_s is smaller by that factor
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
    if (!exists || someone_is_earlier(*first, k >= kManyCandidates)) continue;
    for (int g : pass_) guards_->unmark(g);  // their marks are for the end of the whole step
    if (exempted_closes()) return search(q0, p0, q1, p1, h, tau, path);
    guards_->commit(event_.alpha);
    memory_.h = 0.0;
    return Search::kFound;
  }
  return fail(Search::kUnresolved, suspects_[0].guard, 0);
}

// Whether a step begins where the last one, of the same length, has ended.
bool EventFinder::follows(const VecX& q0, const VecX& p0, double h) const {
  return memory_.h == h && std::equal(q0.data(), q0.data() + q0.size(), memory_.q.data()) &&
         std::equal(p0.data(), p0.data() + p0.size(), memory_.p.data());
}

// Whether no guard can be near in a step after one like it, by the bound on the velocities of bound_step.
bool EventFinder::is_clear(const double* rate, double h) {
  const Tree& tree = scene_->tree;
  if (tree.nq == tree.nv) return guards_->pass(rate, memory_.rate.data(), h);
  return guards_->pass(bound_of(rate, memory_.rate.data()), h);
}

const VecX& EventFinder::bound_of(const double* rate, const double* before) {
  const Tree& tree = scene_->tree;
  const Eigen::Map<const VecX> now(rate, tree.nv), last(before, tree.nv);
  bound_.setZero();
  add_size(tree, now, 1.0, bound_);
  W_ = now - last;
  add_size(tree, W_, 1.0, bound_);
  return bound_;
}

int EventFinder::foresee(const VecX& q0, const VecX& p0, double h, const StepsAhead& steps, int most) {
  if (!follows(q0, p0, h)) return 0;
  const bool plain = scene_->tree.nq == scene_->tree.nv;
  const double* before = memory_.rate.data();
  guards_->look_ahead();
  for (int k = 0; k < most; ++k) {
    const double* rate = steps.next(k, StepsAhead::kRate);
    if (!(plain ? guards_->foresee(rate, before, h) : guards_->foresee(bound_of(rate, before), h))) return k;
    before = rate;
  }
  return most;
}

void EventFinder::pass_foreseen(const StepsAhead& steps, int count) {
  const auto copy = [&](StepsAhead::Part part, VecX& to) {
    std::copy_n(steps.next(count - 1, part), to.size(), to.data());
  };
  forget_last();
  guards_->pass_foreseen(count);
  copy(StepsAhead::kRate, memory_.rate);
  copy(StepsAhead::kQ, memory_.q);
  copy(StepsAhead::kP, memory_.p);
}

bool EventFinder::passes(const VecX& q0, const VecX& p0, const VecX& q1, const VecX& p1, double h, const double* rate) {
  if (rate == nullptr || !follows(q0, p0, h) || !is_clear(rate, h)) return false;
  forget_last();
  guards_->counters.skipped += guards_->count();
  std::copy_n(rate, memory_.rate.size(), memory_.rate.data());
  std::copy_n(q1.data(), q1.size(), memory_.q.data());
  std::copy_n(p1.data(), p1.size(), memory_.p.data());
  return true;
}

// Bound on the velocities of the exact path, from the polynomial and what it leaves out.
bool EventFinder::bound_step() {
  path_->bound(bound_);
  if (path_->stages() > 1) {
    path_->doubt(doubt_);
    bound_ += doubt_;
    return true;
  }
  // A single stage gives the velocity v in the middle only. Velocities reach from v0 to 2 v - v0; after a step of equal
  // length v0 = (previous + v)/2 up to O(h^2).
  path_->chart_rate(0.5, v1_);
  if (follows(*q0_, *p0_, h_)) {
    W_ = v1_ - memory_.rate;
    add_size(scene_->tree, W_, 1.0, bound_);
  } else {
    if (!stepper_->node_velocity(*q0_, *p0_, v0_)) return false;
    W_ = v1_ - v0_;
    add_size(scene_->tree, W_, 2.0, bound_);
  }
  memory_.rate = v1_;
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

// Whether no suspect of a step with one stage comes near zero, which spares the half step that raises its path. The
// velocities of its partial steps lead from v0 to that in the middle of the step; their whole change counts as doubt.
// Those that do not are done with even if others may.
bool EventFinder::plainly_clear() {
  guards_->bound_doubt(doubt_, h_);
  gaps_.set(*path_);
  bool all = true;
  for (Suspect& s : suspects_) {
    if (stays_open(s)) continue;
    bool clear = !memory_.touching[s.guard] && s.end.gap > 0.0;
    if (clear) {
      look_at_start(s);
      clear = gaps_.plainly_clear(s.guard, s.from, s.end.gap);
    }
    if (clear) s.from.tau = 1.0;
    all &= clear;
  }
  return all;
}

// Whether distances along one direction at both ends of the step show that the suspect has no event; it is done with
// then.
bool EventFinder::stays_open(Suspect& s) {
  if (memory_.touching[s.guard] || s.from.tau > 0.0) return s.from.tau == 1.0;
  if (gaps_.others_stay_open(s.guard)) {
    s.from.tau = 1.0;
    return true;
  }
  if (!(s.end.along > 0.0)) return false;
  const bool along = guards_->has_gap_along(s.guard);
  if (!along) look_at_start(s);
  const double start = along ? gaps_.along(s.guard, 0.0, s.end.direction) : s.from.gap;
  if (!(gaps_.least_in_step(s.guard, start, s.end.along, s.held) > 0.0)) return false;
  s.from.tau = 1.0;
  return true;
}

// Bounds the velocities by the path as it is now known; where one may be larger than its bound so far, guards may have
// been left out. False if a gap is not finite.
bool EventFinder::bound_again() {
  path_->doubt(doubt_);
  path_->bound(W_);
  W_ += doubt_;
  const bool grows = (W_.array() > bound_.array()).any();
  bound_ = bound_.cwiseMax(W_);
  if (!grows) return true;
  guards_->bound_motion(*q0_, bound_, h_);
  for (int g : pass_) guards_->unmark(g);
  return collect();
}

void EventFinder::list_touching(std::vector<int>& guards) const {
  guards.clear();
  const std::vector<char>& touching = memory_.touching;
  for (auto at = touching.begin(); (at = std::find(at, touching.end(), 1)) != touching.end(); ++at)
    guards.push_back(static_cast<int>(at - touching.begin()));
}

// What the last search has found about guards.
void EventFinder::forget_last() {
  active_.clear();
  pass_.clear();
  suspects_.clear();
  settled_ = false;
}

// Collects the guards that may reach zero in the step; false if a gap is not finite.
bool EventFinder::collect() {
  forget_last();
  guards_->place(*q1_);
  const std::vector<BroadPhase::NearPair>& near = guards_->near_pairs();
  const int pairs = static_cast<int>(scene_->pairs.size());
  guards_->counters.skipped += pairs - static_cast<long>(near.size());
  for (const BroadPhase::NearPair& pair : near)
    if (!collect(pair.guard)) return false;
  for (int g = pairs; g < guards_->count(); ++g)
    if (!collect(g)) return false;
  return true;
}

// Adds a guard to the suspects if it may reach zero in the step; false if its gap is not finite.
bool EventFinder::collect(int g) {
  const auto exempted = std::find(memory_.exempt.begin(), memory_.exempt.end(), g);
  if (exempted != memory_.exempt.end()) {
    if (guards_->evaluate(g, contact_) >= -guards_->depth_tolerance(g)) {
      active_.push_back(g);  // it has no event of its own, but an event of another guard may close it
      return true;
    }
    memory_.exempt.erase(exempted);  // it does not separate
  }
  if (!memory_.touching[g] && guards_->skip(g)) {
    ++guards_->counters.skipped;
    return true;
  }
  pass_.push_back(g);
  if (!memory_.touching[g] && (guards_->separated_at_end(g) || guards_->others_stay_behind(g))) {
    ++guards_->counters.skipped;
    return true;
  }
  const bool may_jump = guards_->gap_may_jump(g);
  const double gap = may_jump ? guards_->evaluate(g, contact_, gaps_.enough(g)) : guards_->evaluate(g, contact_);
  if (!std::isfinite(gap)) {
    fail(Search::kUnresolved, g, gap);
    return false;
  }
  if (!memory_.touching[g] && (scene_->is_pair(g) ? guards_->reliable(g, gap) : gap) > guards_->motion(g) &&
      !may_jump) {
    guards_->mark(g, gap);
    return true;
  }
  active_.push_back(g);
  const Point none{0.0, 0.0, 0.0};
  Point end{1.0, gap, 0.0};
  gaps_.look_along(g, contact_, end);
  suspects_.push_back({g, end, none, false, false, none, none, false, false, 0.0});
  suspects_.back().held =
      scene_->is_pair(g) && guards_->is_persistent(g) && guards_->is_along_one_direction(g) && guards_->is_held(g);
  return true;
}

void EventFinder::look_at_start(Suspect& s) {
  if (!s.started) s.from = gaps_.at_with_direction(s.guard, 0.0);
  s.started = true;
}

Search EventFinder::start(Suspect& s) {
  if (stays_open(s)) return Search::kNone;
  look_at_start(s);
  const Point a = s.from;
  const double tolerance = Guards::kTouching;
  if (!std::isfinite(a.gap)) return fail(Search::kUnresolved, s.guard, a.gap);
  if (memory_.touching[s.guard] && a.gap > tolerance) memory_.touching[s.guard] = 0;
  if (!memory_.touching[s.guard] && a.gap <= 0.0) {
    // By rounding it touches although no impact was found. If it were deeper an impact would have been missed.
    if (a.gap < -guards_->depth_tolerance(s.guard)) return fail(Search::kUnresolved, s.guard, a.gap);
    set_touching(s.guard, true);
  }
  if (memory_.touching[s.guard]) return separate_touching(s, a);
  return Search::kNone;
}

// Finds the suspect that crosses first on the path; none is followed further than to the first crossing so far.
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
    if (limit == 1.0) {
      s.end.rate = to.rate;
      to = s.end;
    }
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

// Enters a crossing between lo and hi. offset: exact gap minus gap on the path. A sign is sure where the gap is larger
// than the path's error.
void EventFinder::cross(Suspect& s, const Point& lo, const Point& hi, double offset) {
  s.crosses = true;
  s.lo = lo;
  s.hi = hi;
  s.lo_sure = lo.tau == 0.0 || lo.gap > gaps_.doubt(s.guard, lo.tau);
  s.hi_sure = (hi.tau == 1.0 && s.end.gap <= 0.0) || hi.gap < -gaps_.doubt(s.guard, hi.tau);
  s.root = gaps_.root(s.guard, lo, hi, offset);
}

// Whether another guard is below zero at the event, where the guards are placed: then it crosses earlier, or the search
// missed its dip.
bool EventFinder::someone_is_earlier(Suspect& first, bool coarse) {
  const double alpha = event_.alpha;
  first.root = alpha;  // the exact one: by that of the path it might come before them again
  bool earlier = false;
  for (Suspect& s : suspects_) {
    if (&s == &first) continue;
    const double gap = guards_->evaluate(s.guard, contact_);
    if (gap >= -(coarse ? guards_->depth_tolerance(s.guard) : Guards::kTouching)) continue;
    earlier = true;
    const Point before = s.crosses ? s.lo : s.from;
    s.lo_sure = before.tau < alpha && before.gap > gaps_.doubt(s.guard, before.tau);
    s.lo = s.lo_sure ? before : Point{0.5 * alpha, 0.0, 0.0};
    s.hi = {alpha, gap, 0.0};
    s.hi_sure = s.crosses = true;
    s.root = std::nextafter(alpha, 0.0);
  }
  return earlier;
}

bool EventFinder::closes(int guard) { return guards_->evaluate(guard, contact_) < -guards_->depth_tolerance(guard); }

bool EventFinder::exempted_closes() {
  const auto g = std::find_if(memory_.exempt.begin(), memory_.exempt.end(), [&](int guard) { return closes(guard); });
  if (g == memory_.exempt.end()) return false;
  memory_.exempt.erase(g);
  return true;
}

bool EventFinder::closes_before_cut() {
  const auto any = [&](const std::vector<int>& guards) {
    return std::any_of(guards.begin(), guards.end(), [&](int guard) { return closes(guard); });
  };
  return exempted_closes() || any(active_);
}

void EventFinder::cut(double part) {
  const bool settled = settled_;
  forget_step();
  if (settled) guards_->take_back(1.0 - part);
}

void EventFinder::forget_step() {
  guards_->end_span();  // it counts on gaps at the end of the step, as the marks do
  settled_ = false;
  for (int g : pass_) guards_->unmark(g);
  memory_.h = 0.0;
}

// The step has no event: what it has shown about the guards is kept for the next one.
void EventFinder::settle() {
  memory_.exempt.clear();
  for (const Suspect& s : suspects_) {
    if (s.end.gap > Guards::kTouching) memory_.touching[s.guard] = 0;
    if (!memory_.touching[s.guard]) guards_->mark(s.guard, s.end.gap);
  }
  guards_->commit();
  settled_ = true;
  if (active_.empty()) guards_->begin_span(*q1_, bound_, h_);
  remember();
}

// The step is taken to its end.
void EventFinder::remember() {
  memory_.h = h_;
  memory_.q = *q1_;
  memory_.p = *p1_;
}

}  // namespace contactvi

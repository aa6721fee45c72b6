#include "event/switch_finder.hpp"

#include <algorithm>
#include <cmath>

#include "base/tolerances.hpp"

namespace contactvi {

namespace {

// Of the sizes of a function's terms: below it the function counts as zero. A state at a switch has it to rounding, a
// few 1e-16 times the condition of the partial step's equations. Held by tests/simulation/test_switches.py.
constexpr double kZero = 1e-12;
constexpr double kTarget = 1e-14;  // of the same: to where a switch is located if rounding allows it
// A function that is larger than this times what it changes by, over the start and the stages of a step, has no root in
// it. What is left of the step after the last stage, half of it with one stage, brings about as much again.
constexpr double kClear = 3.0;
// A part of a step is clear where all values in it are larger than this times the distance of its middle from its
// chord; a parabola needs 1.
constexpr double kChord = 3.0;
// Parts in which a dip is looked for: a force that acts for less changes the motion by the cube of that, 1e-14.
constexpr double kFinestCell = 0x1p-16;
constexpr double kSmoothPart = 0.125;  // parts of a cell that are cut further even if a root is seen in them
constexpr int kMostProbes = 60;        // exact partial steps to one switch
constexpr double kFarOff = 4.0;  // widths of a part of a step: roots on the path are not farther from the polynomial's
// Where a function that is zero at the start of a step is looked at first, and by how much further each time.
constexpr double kFirstLook = 0x1p-30, kFurther = 8.0;

}  // namespace

SwitchFinder::SwitchFinder(const Tree& tree, Integrator& integrator, SwitchFunctions& functions)
    : tree_(&tree),
      integrator_(&integrator),
      functions_(&functions),
      path_(tree, integrator.stages()),
      v1_(tree.nv),
      q_(tree.nq),
      p_(tree.nv),
      v_(tree.nv),
      q_stage_(tree.nq),
      v_stage_(tree.nv) {}

// By their values at the start and at the stages, which the step has at hand.
bool SwitchFinder::clear_by_stages(const VecX& q0, const VecX& v0) {
  functions_->evaluate(0.0, q0, v0, start_);
  least_ = largest_ = start_;
  for (int i = 0; i < integrator_->stages(); ++i) {
    integrator_->stage_state(i, q_stage_, v_stage_);
    functions_->evaluate(integrator_->stage_place(i), q_stage_, v_stage_, values_);
    least_ = least_.cwiseMin(values_);
    largest_ = largest_.cwiseMax(values_);
  }
  return (least_.array() > kZero + kClear * (largest_ - least_).array()).all();
}

Search SwitchFinder::search(const VecX& q0, const VecX& p0, const VecX& v0, const VecX& q1, const VecX& p1, double h,
                            const VecX& tau) {
  const Eigen::Index count = functions_->count();
  for (VecX* x : {&start_, &values_, &least_, &largest_}) x->resize(count);
  if (clear_by_stages(q0, v0)) return Search::kNone;
  q0_ = &q0;
  p0_ = &p0;
  tau_ = &tau;
  h_ = h;
  probed_ = false;
  if (!integrator_->node_velocity(q1, p1, v1_)) return Search::kNewtonFailed;
  path_.set(q0, h, integrator_->rates());
  path_.raise(v0, v1_);
  Sample end{1.0, VecX(count)};
  functions_->evaluate(1.0, q1, v1_, end.values);
  armed_.assign(static_cast<std::size_t>(count), 0);
  bool all_armed = true;
  for (Eigen::Index k = 0; k < count; ++k) {
    armed_[static_cast<std::size_t>(k)] = start_[k] > kZero;
    all_armed = all_armed && is_armed(static_cast<int>(k));
  }
  // As many cells as the polynomial has bends; before them places that come ever nearer to the start.
  const double cell = 1.0 / std::max(2, integrator_->stages());
  Sample a{0.0, start_};
  double next = all_armed ? cell : kFirstLook;
  while (a.at < 1.0) {
    Sample b = next < 1.0 - 0.5 * cell ? on_path(next) : end;
    const Search found = first(a, b, b.at - a.at);
    if (found != Search::kNone) return found;
    for (Eigen::Index k = 0; k < count; ++k)
      if (b.values[k] > kZero) armed_[static_cast<std::size_t>(k)] = 1;
    a = std::move(b);
    next = a.at < cell ? std::min(cell, kFurther * a.at) : a.at + cell;
  }
  // The integrator is to hold the whole step again.
  return !probed_ || exact(1.0, values_) ? Search::kNone : Search::kNewtonFailed;
}

SwitchFinder::Sample SwitchFinder::on_path(double at) {
  Sample sample{at, VecX(start_.size())};
  path_.configuration(at, q_stage_);
  path_.velocity(at, v_stage_);
  functions_->evaluate(at, q_stage_, v_stage_, sample.values);
  return sample;
}

// The values at the end of the partial step, which is then in q_ and p_.
bool SwitchFinder::exact(double at, VecX& values) {
  probed_ = true;
  if (!integrator_->solve_part(path_, at, *q0_, *p0_, *tau_)) {
    integrator_->forget();  // of other branches, or from where the whole step began
    if (!integrator_->solve_closely(*q0_, *p0_, at * h_, *tau_)) return false;
  }
  integrator_->finish(q_, p_);
  if (!integrator_->node_velocity(q_, p_, v_)) return false;
  functions_->evaluate(at, q_, v_, values);
  return true;
}

// The first root between a and b, which are neighbours, of width times the width of the cell they are in.
Search SwitchFinder::first(const Sample& a, const Sample& b, double width) {
  if (!b.values.allFinite()) return Search::kUnresolved;
  const double part = b.at - a.at;
  bool crosses = false;
  for (Eigen::Index k = 0; k < b.values.size(); ++k)
    crosses |= is_armed(static_cast<int>(k)) ? b.values[k] <= 0.0 : b.values[k] < -kZero;
  if (part <= std::max(kFinestCell, kSmoothPart * width) && crosses) return cross(a, b);
  if (part <= kFinestCell) return Search::kNone;
  const Sample m = on_path(0.5 * (a.at + b.at));
  bool clear = true;
  for (Eigen::Index k = 0; k < b.values.size(); ++k) {
    const double off = std::abs(m.values[k] - 0.5 * (a.values[k] + b.values[k]));
    if (!is_armed(static_cast<int>(k))) continue;  // it has left zero, or not, at b
    clear = clear && std::min({a.values[k], m.values[k], b.values[k]}) > kChord * off;
  }
  if (clear && !crosses) return Search::kNone;
  const Search found = first(a, m, width);
  return found != Search::kNone ? found : first(m, b, width);
}

// A function that is below zero from the start on.
Search SwitchFinder::begins_below(int function) {
  which_ = function;
  alpha_ = 0.0;
  return Search::kFound;
}

// Locates the first one of the functions that cross zero between a and b.
Search SwitchFinder::cross(const Sample& a, const Sample& b) {
  int function = -1;
  double root = 2.0, slope = 0.0;
  for (Eigen::Index k = 0; k < b.values.size(); ++k) {
    const int number = static_cast<int>(k);
    if (is_armed(number) ? b.values[k] > 0.0 : b.values[k] >= -kZero) continue;
    if (start_[k] <= kZero && functions_->may_stay_zero(number)) {
      // Whether it has left zero is not for the polynomial to say.
      if (!exact(b.at, values_)) return Search::kNewtonFailed;
      if (values_[k] >= -kZero) {
        armed_[static_cast<std::size_t>(k)] = 0;
        continue;
      }
      if (a.at <= 0.0) return begins_below(number);
    } else if (!is_armed(number)) {
      return begins_below(number);
    }
    const double drop = a.values[k] - b.values[k];
    const double at = drop > 0.0 ? a.at + (b.at - a.at) * std::clamp(a.values[k] / drop, 0.0, 1.0) : b.at;
    if (at < root) {
      root = at;
      slope = -drop / (b.at - a.at);
      function = number;
    }
  }
  return function < 0 ? Search::kNone : locate(function, a.at, b.at, root, slope);
}

// lo, hi: the function is positive and negative there on the polynomial, with this slope. It may be so not on the exact
// path.
Search SwitchFinder::locate(int function, double lo, double hi, double root, double slope) {
  VecX values(start_.size());
  const double width = std::max(hi - lo, kFinestCell);
  bool lo_sure = lo <= 0.0, hi_sure = false;
  double x = root, before = -1.0, value_before = 0.0;
  for (int k = 0; k < kMostProbes; ++k) {
    if (!exact(x, values)) return Search::kNewtonFailed;
    double value = values[function];
    if (!std::isfinite(value)) return Search::kUnresolved;
    // Another one that was positive at lo and is farther below zero here comes first.
    for (Eigen::Index other = 0; other < values.size(); ++other)
      if (is_armed(static_cast<int>(other)) && values[other] < std::min(-kZero, value)) {
        function = static_cast<int>(other);
        value = values[other];
        before = -1.0;
      }
    which_ = function;
    alpha_ = x;
    const bool stays = before >= 0.0 && std::abs(value) >= 0.25 * std::abs(value_before);
    if (std::abs(value) <= kTarget || (std::abs(value) <= kZero && stays)) return Search::kFound;
    if (value > 0.0 && x >= 1.0) return Search::kNone;
    (value > 0.0 ? lo : hi) = x;
    (value > 0.0 ? lo_sure : hi_sure) = true;
    if (lo_sure && hi_sure && hi - lo <= kNarrowestBracket * hi)
      return value <= 0.0 ? Search::kFound : Search::kUnresolved;
    const double rate = before >= 0.0 ? (value - value_before) / (x - before) : slope;
    double next = rate < 0.0 ? x - value / rate : 0.5 * (lo + hi);
    if (next >= hi && !hi_sure) {
      // The polynomial may have shown a dip that the path has not.
      if (x >= hi && (hi >= 1.0 || hi - root > kFarOff * width)) return Search::kNone;
      next = hi = x < hi ? hi : std::min(1.0, hi + width);
    } else if (next <= lo && !lo_sure) {
      if (x <= lo) lo = std::max(0.0, lo - width);
      lo_sure = lo <= 0.0;
      next = lo_sure ? 0.5 * (lo + hi) : lo;
    } else if (!(next > lo && next < hi) || k % 8 == 7) {
      next = 0.5 * (lo + hi);
    }
    if (next == x) return std::abs(value) <= kZero ? Search::kFound : Search::kUnresolved;
    before = x;
    value_before = value;
    x = next;
  }
  return Search::kUnresolved;
}

}  // namespace contactvi

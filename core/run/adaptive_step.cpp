// Simulator::run_auto: adaptive steps, of equal length between one impact and the next as far as samples allow, and
// between the begin and the end of persistent contact.
//
// The long-time behaviour of a variational integrator rests on a constant step. The step therefore grows only at
// impacts and where contacts change, which break the smooth motion anyway. Where it turns out to be too long it becomes
// shorter, and stays so up to the next one. A step that is too long is mostly seen to be so before it is solved, and
// given up; where there was an impact in it, or where it cannot be solved, at least half of the steps before it stay.
// Contact steps of order 2, where persistent contacts are left to them, have a length of their own, and that of the
// smooth ones is kept for the flight that follows.
#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <utility>
#include <vector>

#include "run/simulator.hpp"

namespace contactvi {

namespace {
constexpr double kSafety = 0.9;
constexpr double kLargestGrowth = 2.0;  // of the step at an impact
// Of the step while the first one of a run is sought, at least, and at most while it takes few iterations: a step far
// from the right length shows that only roughly.
constexpr double kProbeGrowth = 1.6, kLargestProbe = 4.0;
constexpr int kProbes = 16;
// Stage iterations per step: with more than the first number no longer step follows, with more than the second one the
// step is too long.
constexpr double kEasyIterations = 9.0, kManyIterations = 20.0;
constexpr double kBelowFailure = 0.75;   // of a step that did not converge: the longest one from then on
constexpr double kShortestStep = 1e-12;  // of the duration
constexpr double kSamePlanTime = 1e-9;   // of the duration: times of a plan that differ by less are one
// Numbers that the nodes and polynomials of a run may have, 4 GB of them. The accuracy is measured with a second run
// and with copies of both, about four times as much. Longer runs would end where the memory of the machine does.
constexpr double kMostNumbers = 536870912.0;
constexpr double kMostSamples = 2.0;     // in a smooth step that is not cut at each of them
constexpr double kPlanRounding = 1e-14;  // of the duration
constexpr double kNearSample = 1e-9;     // of the time between two: times that differ by less are one

// Where the steps from a time on, of at most `longest` [s], end at a sample, or at the end [s]. Samples between two
// nodes cost as much as steps do, so steps up to twice as long as samples are apart are made as short as these.
double next_sample(double sample, double origin, double time, double longest, double end) {
  if (longest > kMostSamples * sample) return end;
  const double next = origin + sample * (std::floor((time - origin) / sample + kNearSample) + 1.0);
  return next > end - kNearSample * sample ? end : next;
}

// The first of these times after a time, at the latest the end [s]; times that differ by rounding alone are one.
double next_of(const std::vector<double>* times, double time, double end, double duration) {
  if (times == nullptr) return end;
  const auto next = std::upper_bound(times->begin(), times->end(), time + kPlanRounding * duration);
  return next == times->end() ? end : std::min(*next, end);
}

// The steps of one length, from a time to the next sample or the end.
struct Section {
  double begin, end;  // [s]
  double count;       // of steps
  double h() const { return (end - begin) / count; }
};

Section section_of(double begin, double end, double longest) {
  return {begin, end, std::clamp(std::ceil((end - begin) / longest - 1e-9), 1.0, 1e15)};
}
}  // namespace

// Goes back to the start of the steps that are redone; what they have cost stays in the counts.
void Simulator::redo_from(const Snapshot& start, const Recording::Mark& mark, Recording& recording) {
  const RunState& now = state_;
  const long rejected = now.rejected + now.step - start.run.step + 1, halved = now.control.halved,
             saturated = now.actuators.saturated;
  const SwitchCounts switches = now.switches;
  const double adaptive_dt = now.adaptive_dt, contact_seconds = now.contact_seconds;
  restore_state(start);
  state_.rejected = rejected;
  state_.control.halved = halved;
  state_.actuators.saturated = saturated;
  state_.switches = switches;
  state_.adaptive_dt = adaptive_dt;
  state_.contact_seconds = contact_seconds;
  recording.cut(mark);
}

// Steps that a run may keep.
double Simulator::most_steps() const {
  const double nq = scene_->tree.nq, nv = scene_->tree.nv, node = 1.0 + nq + nv;
  return kMostNumbers / (node + (options_.dense ? 3.0 + nq + (2.0 + options_.stages) * nv : 0.0));
}

bool Simulator::end_with_too_many_steps(double time, double h) {
  std::ostringstream message;
  message << "the accuracy needs steps of " << h << " s here, more of them than are kept (" << most_steps() << ")";
  return end(StatusCode::kTooManySteps, time, message.str());
}

// Whether the steps that come are contact steps, of a length of their own, or dense steps.
bool Simulator::takes_contact_steps() const {
  return state_.dense.active || (!contact_step_.empty() && !keeps_constraints_);
}

// Steps to the end of the one with the next impact, or in which persistent contact begins or ends; to where the length
// turns out to be too long or that of the plan changes; or to the end of the run.
bool Simulator::run_adaptive_steps(double end, double origin, const AutoSteps& steps, Recording& recording) {
  const VecX no_force;
  const bool has_servos = scene_->tree.elements.servo_kp.size() > 0;
  const double s = options_.stages, began = state_.time, level = steps.level;
  const bool persistent = takes_contact_steps();
  if (steps.plan != nullptr) end = take_plan(*steps.plan, end, persistent);
  const double duration = end - began;
  const long impacts = state_.impacts;
  const std::size_t changes = recording.changes.size();
  const double adaptive_dt = state_.adaptive_dt, longest_dt = truncation_.longest_dt;
  int probes = persistent || !recording.adaptive_t.empty() || steps.plan != nullptr ? 0 : kProbes;
  double largest = 0.0, largest_h = 0.0, smooth = 0.0;
  long most_iterations = 0;
  Section section;
  std::vector<std::pair<double, double>> lengths;  // of the steps, each from a time on [s]
  const auto enter = [&](double begin) {
    const double longest = persistent ? std::min(contact_dt(), truncation_.longest_contact) : state_.adaptive_dt;
    const double limit = next_of(steps.ends, begin, end, end - origin);
    section = section_of(begin, persistent ? limit : next_sample(steps.sample, origin, begin, longest, limit), longest);
    smooth = std::min(section.h(), state_.adaptive_dt);  // the longest smooth step of an interval
    state_.control.free.longest = truncation_.length = smooth;
    const double h = section.h();
    if (lengths.empty() || std::abs(h - lengths.back().second) > kNearSample * h) lengths.emplace_back(begin, h);
  };
  enter(began);
  // To which the run goes back where something was done in a step that is too long: at least half of the steps stay.
  Snapshot start = snapshot();
  Recording::Mark mark = recording.mark();
  long kept = 0;
  bool shortened = false;
  double in_section = 0.0;  // steps of it that were made
  for (long k = 0; state_.time < end;) {
    const double h = section.h();
    // Without guards the length does not grow again.
    if (guards_.count() == 0 && (end - section.begin) / h > most_steps()) return end_with_too_many_steps(began, h);
    if (k >= 2 * kept && k > kept) {
      start = snapshot();
      mark = recording.mark();
      kept = k;
    }
    const bool shortest = smooth < kShortestStep * duration;
    truncation_.largest = 0.0;
    truncation_.iterations = 0;
    truncation_.limited = !shortest;
    truncation_.too_long = false;
    const DensePhase dense = state_.dense;
    const double step_start = section.begin + in_section * h;
    if (has_servos) actuation_.set(step_start, no_force, steps.target, 0, state_.q, state_.p);
    const bool made = advance_interval(step_start, h, has_servos ? actuation_.force() : no_force, recording),
               solved = made || truncation_.too_long;
    truncation_.limited = false;
    const StatusCode code = state_.status.code;
    const bool retry = code == StatusCode::kNewtonFailed || code == StatusCode::kEventUnresolved ||
                       (code == StatusCode::kConstraint && contact_step_.empty());
    if (!solved && !retry) return false;
    const double seen = solved ? truncation_.largest : std::numeric_limits<double>::infinity();
    const double iterations = static_cast<double>(truncation_.iterations);
    if (!solved && shortest) return false;
    bool again = seen > level && !shortest;
    // A step that was given up before anything was done in it leaves the steps before it as they are.
    const bool here = again && !made && truncation_.too_long && truncation_.first;
    if (again && persistent && !solved) {
      truncation_.longest_contact = 0.5 * h;
    } else if (again) {
      // The truncation is of the order h^s; a step that did not converge is halved.
      state_.adaptive_dt = smooth * (solved ? std::max(0.2, kSafety * std::pow(level / seen, 1.0 / s)) : 0.5);
      if (!solved) truncation_.longest_dt = kBelowFailure * h;
    } else if (k == 0 && probes-- > 0 && h < duration && state_.impacts == impacts && iterations <= kEasyIterations) {
      const double largest_probe = 2.0 * iterations <= kEasyIterations ? kLargestProbe : kProbeGrowth;
      const double growth = std::min(kSafety * std::pow(level / std::max(seen, 1e-300), 1.0 / s), largest_probe);
      again = growth >= kProbeGrowth && growth * h <= truncation_.longest_dt;
      if (again) state_.adaptive_dt = growth * h;
    }
    if (again) {
      if (here) {
        state_.dense = dense;
        ++state_.rejected;
      } else {
        redo_from(start, mark, recording);
      }
      while (lengths.size() > 1 && lengths.back().first >= state_.time) lengths.pop_back();
      shortened = here ? k > 0 : kept > 0;
      if (shortened) break;
      k = 0;
      in_section = 0.0;
      largest = 0.0;
      most_iterations = 0;
      lengths.clear();
      enter(began);
      continue;
    }
    if (seen >= largest) largest_h = h;
    largest = std::max(largest, seen);
    most_iterations = std::max(most_iterations, truncation_.iterations);
    ++k;
    ++state_.step;
    in_section += 1.0;
    state_.time = in_section == section.count ? section.end : section.begin + in_section * h;
    record_node(state_.time, recording);
    if (!report_progress(state_.time)) return false;
    if (static_cast<double>(recording.t.size()) > most_steps()) return end_with_too_many_steps(state_.time, h);
    if (persistent != takes_contact_steps()) break;
    if (!persistent && (state_.impacts > impacts || recording.changes.size() > changes)) break;
    if (in_section == section.count && section.end < end) {
      in_section = 0.0;
      enter(section.end);
    }
  }
  if (persistent) {
    if (!shortened) truncation_.longest_contact = std::numeric_limits<double>::infinity();
    return true;
  }
  for (const auto& [time, h] : lengths) {
    recording.adaptive_t.push_back(time);
    recording.adaptive_dt.push_back(h);
  }
  if (state_.dense.active) {  // Events made the steps short, which are left to dense steps now.
    state_.adaptive_dt = adaptive_dt;
    truncation_.longest_dt = longest_dt;
    return true;
  }
  if (!shortened && steps.plan == nullptr) grow_adaptive_step(largest_h, largest, level, most_iterations);
  return true;
}

// Sets the length of the smooth steps after an impact, from what was seen in those before it, of length h [s].
void Simulator::grow_adaptive_step(double h, double largest, double level, long most_iterations) {
  double growth = kSafety * std::pow(level / std::max(largest, 1e-300), 1.0 / static_cast<double>(options_.stages));
  const double iterations = static_cast<double>(most_iterations);
  // Steps close to the longest length that converges take so many iterations that shorter ones are cheaper.
  if (iterations > kEasyIterations) growth = std::min(growth, iterations > kManyIterations ? 1.0 / kProbeGrowth : 1.0);
  state_.adaptive_dt = std::min(truncation_.longest_dt, h * std::clamp(growth, 1.0 / kLargestGrowth, kLargestGrowth));
}

// Whether an adaptive step of this length that was not solved is to be made again shorter before dense steps go on:
// down to the length of contact steps, and where nothing has touched in it. impacts: how many there were before it.
bool Simulator::may_be_shortened(double length, long impacts) const {
  const bool untouched = contact_step_.empty() && state_.impacts == impacts;
  return truncation_.bound > 0.0 &&
         (length > contact_dt() * (1.0 + 1e-9) || (untouched && state_.status.code == StatusCode::kNewtonFailed));
}

// Sets the length of the smooth steps from now on, and returns where it changes, at the latest at the end [s]: one
// length from one step with an impact of the plan's run to the next. A run that looks for its steps finds out late that
// they are too long, so it is the shortest one; where the motion multiplies errors the steps before that would leave
// nearly all of the error. A run by a plan has one length that is cut at samples, so it is the longest one. Contact
// steps go on there as they are.
double Simulator::take_plan(const StepPlan& plan, double end, bool persistent) {
  const std::vector<double>&t = plan.run.adaptive_t, &dt = plan.run.adaptive_dt;
  // Whether none of these lies between the change of length before this one and this one.
  const auto none_between = [&](const auto& records, std::size_t k) {
    const auto next = std::upper_bound(records.begin(), records.end(), t[k - 1],
                                       [](double time, const auto& record) { return time < record.time; });
    return next == records.end() || next->time > t[k];
  };
  const auto goes_on = [&](std::size_t k) {
    return none_between(plan.run.impacts, k) && none_between(plan.run.changes, k);
  };
  const double now = state_.time + kSamePlanTime * (end - t[0]);
  const std::size_t next = static_cast<std::size_t>(std::upper_bound(t.begin(), t.end(), now) - t.begin());
  std::size_t first = std::max<std::size_t>(next, 1) - 1, last = first + 1;
  while (first > 0 && goes_on(first)) --first;
  while (last < t.size() && goes_on(last)) ++last;
  const auto [shortest, longest] = std::minmax_element(&dt[first], &dt[first] + (last - first));
  state_.adaptive_dt = plan.part * (plan.planned ? *longest : *shortest);
  return last < t.size() && !persistent ? std::min(t[last], end) : end;
}

Status Simulator::run_auto(double duration, const AutoSteps& steps, const Progress& progress, Recording& recording) {
  const double origin = state_.time, end = origin + duration;
  start_recording(progress, recording);
  truncation_.bound = steps.level;
  truncation_.after_impact = steps.after_impact;
  truncation_.longest_dt = truncation_.longest_contact = std::numeric_limits<double>::infinity();
  actuation_.follow(steps.references);
  bool ok = true;
  while (ok && state_.time < end) ok = run_adaptive_steps(end, origin, steps, recording);
  actuation_.follow(nullptr);
  truncation_.bound = 0.0;
  truncation_.too_long = false;
  truncation_.after_impact = 1;
  state_.control.free.longest = options_.dt;
  state_.start_time = state_.time - static_cast<double>(state_.step) * options_.dt;  // for steps of dt that may follow
  if (ok) {
    state_.status.time = state_.time;
  } else if (state_.status.code != StatusCode::kNotFinite && state_.status.time > recording.t.back()) {
    record_node(state_.status.time, recording);
  }
  return state_.status;
}

}  // namespace contactvi

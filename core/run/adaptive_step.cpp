// Simulator::run_auto: adaptive steps, of equal length between one impact and the next.
//
// The long-time behaviour of a variational integrator rests on a constant step. The step therefore changes only at
// impacts, which break the smooth motion anyway; where it turns out to be too long, all steps since the last impact are
// redone with a shorter one.
#include <algorithm>
#include <cmath>
#include <limits>

#include "run/simulator.hpp"

namespace contactvi {

namespace {
constexpr double kSafety = 0.9;
constexpr double kLargestGrowth = 2.0;  // of the step at an impact
constexpr double kProbeGrowth = 1.6;    // of the step while the first one of a run is sought
constexpr int kProbes = 16;
// Stage iterations per step: with more than the first number no longer step follows, with more than the second one the
// step is too long.
constexpr double kEasyIterations = 9.0, kManyIterations = 20.0;
constexpr double kBelowFailure = 0.75;   // of a step that did not converge: the longest one from then on
constexpr double kShortestStep = 1e-12;  // of the duration
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
}  // namespace

Simulator::AdaptiveStart Simulator::adaptive_start(const Recording& recording) const {
  AdaptiveStart start{time_,
                      largest_speed_,
                      reference_,
                      q_,
                      p_,
                      {},
                      bouncing_,
                      contact_step_.contacts(),
                      recording.mark(),
                      impacts_,
                      step_,
                      work_,
                      reactions_,
                      node_time_};
  start.touching.resize(guards_.count());
  for (int g = 0; g < guards_.count(); ++g) start.touching[g] = finder_.touching(g) ? 1 : 0;
  return start;
}

void Simulator::return_to(const AdaptiveStart& start, Recording& recording) {
  rejected_ += step_ - start.step + 1;
  time_ = start.time;
  reference_ = start.reference;
  largest_speed_ = start.largest_speed;
  q_ = start.q;
  p_ = start.p;
  bouncing_ = start.bouncing;
  impacts_ = start.impacts;
  contact_step_.contacts() = start.persistent;
  contact_step_.invalidate();
  separated_.clear();
  flight_dt_ = kinetic_ = 0.0;
  work_ = start.work;
  reactions_ = start.reactions;
  node_time_ = start.node_time;
  step_ = start.step;
  for (int g = 0; g < guards_.count(); ++g) finder_.set_touching(g, start.touching[g] != 0);
  guards_.restart();
  update_persistent_guards();
  integrator_.forget();
  recording.cut(start.mark);
  status_ = {StatusCode::kSuccess, "", time_, -1, kNaN, kNaN};
}

// Steps of one length: to the end of the step with the next impact, or to the end of the run.
bool Simulator::run_adaptive_steps(double end, double level, Recording& recording) {
  const AdaptiveStart start = adaptive_start(recording);
  const VecX no_force;
  const double s = options_.stages, duration = end - start.time;
  int probes = recording.adaptive_t.empty() ? kProbes : 0;
  double largest = 0.0, most_iterations = 0.0;
  for (;;) {
    const double count = std::clamp(std::ceil(duration / adaptive_dt_ - 1e-9), 1.0, 1e15), h = duration / count;
    bool rejected = false;
    largest = most_iterations = 0.0;
    trial_dt_ = h;
    for (long k = 0; k < static_cast<long>(count) && !rejected; ++k) {
      truncation_ = 0.0;
      const double step_start = start.time + static_cast<double>(k) * h;
      const long before = integrator_.counters.stage_iterations;
      const bool solved = advance_interval(step_start, h, no_force, recording);
      const double stage_iterations = static_cast<double>(integrator_.counters.stage_iterations - before);
      most_iterations = std::max(most_iterations, stage_iterations);
      const bool retry = status_.code == StatusCode::kNewtonFailed || status_.code == StatusCode::kEventUnresolved;
      if (!solved && !retry) return false;
      const double seen = solved ? truncation_ : std::numeric_limits<double>::infinity();
      largest = std::max(largest, seen);
      const bool shortest = h < kShortestStep * duration;
      if (!solved && shortest) return false;
      if (seen > level && !shortest) {
        // The truncation is of the order h^s; a step that did not converge is halved.
        const double factor = solved ? std::max(0.2, kSafety * std::pow(level / seen, 1.0 / s)) : 0.5;
        adaptive_dt_ = factor * h;
        if (!solved) longest_dt_ = kBelowFailure * h;
        rejected = true;
        break;
      }
      if (k == 0 && probes-- > 0 && count > 1.0 && stage_iterations <= kEasyIterations &&
          kProbeGrowth * h <= longest_dt_ && seen < level * std::pow(1.0 / kProbeGrowth, s)) {
        adaptive_dt_ = kProbeGrowth * h;
        rejected = true;
        break;
      }
      ++step_;
      time_ = k + 1 == static_cast<long>(count) ? end : step_start + h;
      record_node(time_, recording);
      if (!report_progress(time_)) return false;
      if (impacts_ > start.impacts) break;
    }
    if (!rejected) {
      recording.adaptive_t.push_back(start.time);
      recording.adaptive_dt.push_back(h);
      double growth = kSafety * std::pow(level / std::max(largest, 1e-300), 1.0 / s);
      // Steps close to the longest length that converges take so many iterations that shorter ones are cheaper.
      if (most_iterations > kEasyIterations)
        growth = std::min(growth, most_iterations > kManyIterations ? 1.0 / kProbeGrowth : 1.0);
      adaptive_dt_ = std::min(longest_dt_, h * std::clamp(growth, 1.0 / kLargestGrowth, kLargestGrowth));
      return true;
    }
    return_to(start, recording);
  }
}

Status Simulator::run_auto(double duration, double level, const Progress& progress, Recording& recording) {
  status_ = {StatusCode::kSuccess, "", time_, -1, kNaN, kNaN};
  const double end = time_ + duration;
  if (recording.t.empty()) record_node(time_, recording);
  recording.changes.insert(recording.changes.end(), initial_changes_.begin(), initial_changes_.end());
  initial_changes_.clear();
  last_report_ = std::chrono::steady_clock::now();
  progress_ = &progress;
  truncation_bound_ = level;
  longest_dt_ = std::numeric_limits<double>::infinity();
  bool ok = true;
  while (ok && time_ < end) ok = run_adaptive_steps(end, level, recording);
  truncation_bound_ = 0.0;
  trial_dt_ = options_.dt;
  t0_ = time_ - static_cast<double>(step_) * options_.dt;  // for steps of dt that may follow
  if (ok) {
    status_.time = time_;
  } else if (status_.code != StatusCode::kNotFinite && status_.time > recording.t.back()) {
    record_node(status_.time, recording);
  }
  return status_;
}

}  // namespace contactvi

// Simulator::run_auto: steps of equal length within each smooth arc, between one impact and the next.
//
// A variational integrator is good because its step is constant; so the step changes only where an impact breaks the
// motion anyway, and an arc that turns out to need a shorter one is redone as a whole.
#include <algorithm>
#include <cmath>
#include <limits>

#include "run/simulator.hpp"

namespace contactvi {

namespace {
constexpr double kSafety = 0.9;
constexpr double kLargestGrowth = 2.0;  // of the step from one arc to the next
constexpr double kProbeGrowth = 1.6;    // while the first step of a run is sought
constexpr int kProbes = 16;
constexpr double kEasySweeps = 9.0, kManySweeps = 20.0;  // per step: what a longer one may follow, what is too long
constexpr double kBelowFailure = 0.75;      // of a step that did not converge: the longest tried from then on
constexpr double kShortestArcStep = 1e-12;  // of the duration
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
}  // namespace

Simulator::ArcStart Simulator::arc_start(const Recording& recording) const {
  ArcStart arc{time_,
               sequence_.target,
               speed_scale_,
               q_,
               p_,
               {},
               bouncing_,
               held_.contacts(),
               recording.mark(),
               sequence_.impacts,
               step_,
               target_step_,
               work_,
               reactions_,
               node_time_};
  arc.touching.resize(guards_.count());
  for (int g = 0; g < guards_.count(); ++g) arc.touching[g] = finder_.touching(g) ? 1 : 0;
  return arc;
}

void Simulator::go_back(const ArcStart& arc, Recording& recording) {
  rejected_ += step_ - arc.step + 1;
  time_ = arc.time;
  sequence_.target = arc.target;
  speed_scale_ = arc.speed_scale;
  q_ = arc.q;
  p_ = arc.p;
  bouncing_ = arc.bouncing;
  sequence_.impacts = arc.impacts;
  held_.contacts() = arc.held;
  held_.changed();
  left_.clear();
  flight_trial_ = kinetic_ = 0.0;
  work_ = arc.work;
  reactions_ = arc.reactions;
  node_time_ = arc.node_time;
  step_ = arc.step;
  target_step_ = arc.target_step;
  for (int g = 0; g < guards_.count(); ++g) finder_.set_touching(g, arc.touching[g] != 0);
  guards_.unmark_all();
  sync_held();
  integrator_.forget();
  recording.cut(arc.mark);
  status_ = {StatusCode::kSuccess, "", time_, -1, kNaN, kNaN};
}

// One arc: to the end of the step in which its impact is, or to the end of the run.
bool Simulator::run_arc(double end, double level, Recording& recording) {
  const ArcStart arc = arc_start(recording);
  const VecX no_force;
  const double s = options_.stages, duration = end - arc.time;
  int probes = recording.arc_t.empty() ? kProbes : 0;
  double largest = 0.0, most_sweeps = 0.0;
  for (;;) {
    const double count = std::clamp(std::ceil(duration / arc_h_ - 1e-9), 1.0, 1e15), h = duration / count;
    bool rejected = false;
    largest = most_sweeps = 0.0;
    trial_ = h;
    for (long k = 0; k < static_cast<long>(count) && !rejected; ++k) {
      truncation_ = 0.0;
      const double start = arc.time + static_cast<double>(k) * h;
      const long before = integrator_.counters.sweeps;
      const bool solved = interval(start, h, no_force, recording);
      const double sweeps = static_cast<double>(integrator_.counters.sweeps - before);
      most_sweeps = std::max(most_sweeps, sweeps);
      const bool retry = status_.code == StatusCode::kNewtonFailed || status_.code == StatusCode::kEventUnresolved;
      if (!solved && !retry) return false;
      const double seen = solved ? truncation_ : std::numeric_limits<double>::infinity();
      largest = std::max(largest, seen);
      const bool shortest = h < kShortestArcStep * duration;
      if (!solved && shortest) return false;
      if (seen > level && !shortest) {
        // Truncation goes with h^s; a step that did not converge is halved.
        const double factor = solved ? std::max(0.2, kSafety * std::pow(level / seen, 1.0 / s)) : 0.5;
        arc_h_ = factor * h;
        if (!solved) longest_h_ = kBelowFailure * h;
        rejected = true;
        break;
      }
      if (k == 0 && probes-- > 0 && count > 1.0 && sweeps <= kEasySweeps && kProbeGrowth * h <= longest_h_ &&
          seen < level * std::pow(1.0 / kProbeGrowth, s)) {
        arc_h_ = kProbeGrowth * h;
        rejected = true;
        break;
      }
      ++step_;
      time_ = k + 1 == static_cast<long>(count) ? end : start + h;
      record_node(time_, recording);
      if (!report(time_)) return false;
      if (sequence_.impacts > arc.impacts) break;
    }
    if (!rejected) {
      recording.arc_t.push_back(arc.time);
      recording.arc_dt.push_back(h);
      double growth = kSafety * std::pow(level / std::max(largest, 1e-300), 1.0 / s);
      // Steps near the longest that converge cost more than they cover.
      if (most_sweeps > kEasySweeps) growth = std::min(growth, most_sweeps > kManySweeps ? 1.0 / kProbeGrowth : 1.0);
      arc_h_ = std::min(longest_h_, h * std::clamp(growth, 1.0 / kLargestGrowth, kLargestGrowth));
      return true;
    }
    go_back(arc, recording);
  }
}

Status Simulator::run_auto(double duration, double level, const Progress& progress, Recording& recording) {
  status_ = {StatusCode::kSuccess, "", time_, -1, kNaN, kNaN};
  const double end = time_ + duration;
  if (recording.t.empty()) record_node(time_, recording);
  recording.changes.insert(recording.changes.end(), begun_.begin(), begun_.end());
  begun_.clear();
  reported_ = std::chrono::steady_clock::now();
  progress_ = &progress;
  level_ = level;
  longest_h_ = std::numeric_limits<double>::infinity();
  bool ok = true;
  while (ok && time_ < end) ok = run_arc(end, level, recording);
  level_ = 0.0;
  trial_ = options_.dt;
  t0_ = time_ - static_cast<double>(step_) * options_.dt;  // should steps of dt follow
  if (ok) {
    status_.time = time_;
  } else if (status_.code != StatusCode::kNotFinite && status_.time > recording.t.back()) {
    record_node(status_.time, recording);
  }
  return status_;
}

}  // namespace contactvi

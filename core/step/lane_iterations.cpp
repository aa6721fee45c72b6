#include "step/lane_iterations.hpp"

#include <algorithm>

namespace contactvi {

LaneIterations::Key LaneIterations::key(const Integrator& step) {
  return {step.asks_ahead_ ? 0 : step.iteration_.flags(), StageLanes::kind(step.stages_), step.asks_ahead_};
}

void LaneIterations::iterate(std::vector<Integrator*>& steps) {
  while (!steps.empty()) {
    seat(steps);
    if (seated_.size() == 1) continue;
    if (!seated_[0]->asks_ahead_) {
      iterate_seated(steps);
      continue;
    }
    if (!flight_) flight_ = std::make_unique<LaneFlight>(*seated_[0]->tree_, seated_[0]->model_, lanes_);
    made_ += flight_->fly(seated_);
  }
}

// Takes out the steps that make the same iteration as the first one.
void LaneIterations::seat(std::vector<Integrator*>& steps) {
  const Key first = key(*steps[0]);
  seated_.clear();
  std::size_t kept = 0;
  for (Integrator* step : steps) {
    if (static_cast<int>(seated_.size()) < StageLanes::most_runs() && key(*step) == first) {
      seated_.push_back(step);
    } else {
      steps[kept++] = step;
    }
  }
  steps.resize(kept);
}

// All lanes make a factor, and go on with it. A step that makes another one leaves, and is seated again with others
// that do: so no factor is ever copied.
void LaneIterations::iterate_seated(std::vector<Integrator*>& steps) {
  stages_.clear();
  for (Integrator* step : seated_) stages_.push_back(&step->stages_);
  int flags = seated_[0]->iteration_.flags();
  lanes_.seat(stages_);
  for (std::size_t left = seated_.size(); left > 0;) {
    lanes_.iterate(flags);
    for (std::size_t lane = 0; lane < seated_.size(); ++lane) {
      Integrator* step = seated_[lane];
      if (step == nullptr) continue;
      step->count_iteration(flags);
      ++made_;
      if (judge(static_cast<int>(lane))) continue;
      lanes_.fetch(static_cast<int>(lane));
      if (step->iteration_.goes_on()) steps.push_back(step);
      seated_[lane] = nullptr;
      --left;
    }
    flags &= ~(kLaneFactor | kLaneFirst);
  }
}

// Whether the step in a lane makes a further iteration with its factor.
bool LaneIterations::judge(int lane) {
  Integrator& step = *seated_[lane];
  lanes_.fetch_numbers(lane);
  step.judge_iteration();
  if (step.iteration_.accelerates()) {
    lanes_.fetch_correction(lane);
    step.accelerate();
    lanes_.put_velocity(lane);
  }
  return step.iteration_.goes_on() && (step.iteration_.flags() & kLaneFactor) == 0;
}

}  // namespace contactvi

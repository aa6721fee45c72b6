#include "step/lane_flight.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {

constexpr int kBefore = StartValues::kSteps;

bool is_angle(JointType type) { return type == JointType::kRevolute || type == JointType::kHelical; }

// The same number for all dofs of a lane: loops over dofs and lanes are then loops over one list.
void fill_lane(double* to, double value, int size, int width, int lane) {
  for (int i = lane; i < size; i += width) to[i] = value;
}

}  // namespace

LaneFlight::LaneFlight(const FlatModel& model, StageLanes& lanes)
    : lanes_(&lanes),
      nv_(model.lanes.nv),
      width_(StageLanes::most_runs()),
      size_(nv_ * width_),
      turn_(size_),
      winds_(nv_),
      steps_(static_cast<std::size_t>(StepsAhead::kMost * StepsAhead::kParts) * size_),
      history_(static_cast<std::size_t>(kBefore) * size_),
      weight_(static_cast<std::size_t>(kBefore + 1) * size_),
      q_(size_),
      carry_q_(size_),
      carry_p_(size_),
      flies_(width_),
      pending_(width_),
      iterations_(width_),
      past_(kBefore) {}

long LaneFlight::fly(const std::vector<Integrator*>& runs) {
  int steps = StepsAhead::kMost;
  for (const Integrator* run : runs) steps = std::min(steps, run->ahead_.wanted());
  board(runs);
  long made = 0;
  for (int step = 0; step < steps; ++step) {
    start_values(step);
    made += iterate(runs, step);
    finish(step);
    leave(runs, step);
    set_base(runs);
    if (std::none_of(flies_.begin(), flies_.end(), [](char flies) { return flies != 0; })) break;
  }
  for (Integrator* run : runs)
    if (!run->ahead_.any()) run->ahead_.pause();
  return made;
}

// The runs take their lanes with all that their next steps depend on.
void LaneFlight::board(const std::vector<Integrator*>& runs) {
  const Tree& tree = *runs[0]->tree_;
  for (std::size_t i = 0; i < tree.joints.size(); ++i) {
    const Joint& joint = tree.joints[i];
    for (int d = joint.iv; d < joint.iv + joint.nv; ++d) {
      winds_[d] = joint.type == JointType::kRevolute ? 1 : 0;
      // Adding -0 changes no number.
      const double turn = is_angle(joint.type) ? runs[0]->model_.joints[i].turn : -0.0;
      std::fill_n(turn_.begin() + d * width_, width_, turn);
    }
  }
  std::vector<Stages*>& stages = lanes_->boarding_;
  stages.clear();
  for (Integrator* run : runs) stages.push_back(&run->stages_);
  lanes_->seat(stages);
  for (int lane = 0; lane < width_; ++lane) {
    Integrator& run = *runs[std::min<std::size_t>(lane, runs.size() - 1)];
    lanes_->put(run.q0_.data(), q_.data(), nv_, lane);
    lanes_->put(run.carry_q_.data(), carry_q_.data(), nv_, lane);
    lanes_->put(run.carry_p_.data(), carry_p_.data(), nv_, lane);
    run.start_.weigh(run.h_);
    for (int m = 0; m < kBefore; ++m) {
      lanes_->put(run.start_.history(m).data(), history_.data() + (kBefore - 1 - m) * size_, nv_, lane);
      fill_lane(weight_.data() + m * size_, run.start_.weight_[m][0], size_, width_, lane);
    }
    fill_lane(weight_.data() + kBefore * size_, run.stages_.hb()[0], size_, width_, lane);
    flies_[lane] = lane < static_cast<int>(runs.size()) ? 1 : 0;
    if (flies_[lane]) run.ahead_.begin(run.q0_, run.p0_, run.h_, run.iteration_.tol());
  }
}

// The extrapolation of StartValues, in its order.
void LaneFlight::start_values(int step) {
  for (int m = 0; m < kBefore; ++m) {
    const int before = step - 1 - m;
    past_[m] = before >= 0 ? at(before, StepsAhead::kV) : history_.data() + (kBefore + before) * size_;
  }
  double* __restrict v = lanes_->v_;
  for (int m = 0; m < kBefore; ++m) {
    const double* __restrict past = past_[m];
    const double* __restrict weight = weight_.data() + m * size_;
    if (m == 0)
      for (int i = 0; i < size_; ++i) v[i] = past[i] * weight[i];
    else
      for (int i = 0; i < size_; ++i) v[i] = v[i] + past[i] * weight[i];
  }
}

// Iterates all lanes until the last one is done. What a lane would have alone is kept where it is done.
long LaneFlight::iterate(const std::vector<Integrator*>& runs, int step) {
  long made = 0;
  int flags = 0;
  pending_ = flies_;
  for (std::size_t lane = 0; lane < runs.size(); ++lane) {
    if (!flies_[lane]) continue;
    iterations_[lane] = 0;
    runs[lane]->iteration_.begin(false);
    flags = runs[lane]->iteration_.flags();
  }
  const auto started = std::count(pending_.begin(), pending_.end(), 1);
  for (auto left = started; left > 0;) {
    lanes_->iterate(flags);
    flags &= ~(kLaneFactor | kLaneFirst);
    made += left;
    const auto before = left;
    done_.clear();
    for (int lane = 0; lane < static_cast<int>(runs.size()); ++lane) {
      if (!pending_[lane]) continue;
      StageIteration& own = runs[lane]->iteration_;
      lanes_->fetch_numbers(lane);
      own.judge(runs[lane]->stages_);
      ++iterations_[lane];
      if (own.goes_on() && (own.flags() & (kLaneFactor | kLaneNewton)) == 0 && !own.accelerates()) continue;
      pending_[lane] = 0;
      flies_[lane] = own.solved() ? 1 : 0;
      --left;
      if (flies_[lane]) done_.push_back(lane);
    }
    if (left == 0 && before == started) {  // nothing was kept before
      keep_all(step);
    } else {
      for (int lane : done_) keep(step, lane);
    }
  }
  return made;
}

void LaneFlight::keep(int step, int lane) {
  const double* from[] = {lanes_->v_, lanes_->X_, lanes_->P_, lanes_->G_, lanes_->dv_};
  for (int k = 0; k < 5; ++k) {
    double* to = at(step, static_cast<StepsAhead::Part>(StepsAhead::kV + k));
    for (int d = lane; d < size_; d += width_) to[d] = from[k][d];
  }
}

void LaneFlight::keep_all(int step) {
  const double* from[] = {lanes_->v_, lanes_->X_, lanes_->P_, lanes_->G_, lanes_->dv_};
  for (int k = 0; k < 5; ++k) std::copy_n(from[k], size_, at(step, static_cast<StepsAhead::Part>(StepsAhead::kV + k)));
}

// StepEquations::finish, lane by lane.
void LaneFlight::finish(int step) {
  const double* __restrict weight = weight_.data() + kBefore * size_;
  const auto add = [&](const double* __restrict rate, double* __restrict base, double* __restrict carry,
                       double* __restrict end, double* __restrict lost) {
    for (int i = 0; i < size_; ++i) {
      const double change = weight[i] * rate[i] + carry[i];
      const double total = base[i] + change;
      lost[i] = carry[i] = change - (total - base[i]);
      end[i] = base[i] = total;
    }
  };
  add(at(step, StepsAhead::kForce), lanes_->p0_, carry_p_.data(), at(step, StepsAhead::kP),
      at(step, StepsAhead::kCarryP));
  add(at(step, StepsAhead::kV), q_.data(), carry_q_.data(), at(step, StepsAhead::kQ), at(step, StepsAhead::kCarryQ));
}

// Stages::set_base, for angles from which no revolutions are taken off: others end the flight.
void LaneFlight::set_base(const std::vector<Integrator*>& runs) {
  double* __restrict base = lanes_->base_;
  const double* __restrict q = q_.data(), * __restrict turn = turn_.data();
  bool far = false;
  for (int i = 0; i < size_; ++i) {
    base[i] = q[i] + turn[i];
    far |= !(std::abs(base[i]) <= Stages::kManyTurns);
  }
  if (!far) return;
  for (int d = 0; d < nv_; ++d)
    for (std::size_t lane = 0; lane < runs.size(); ++lane)
      if (winds_[d] && !(std::abs(base[d * width_ + static_cast<int>(lane)]) <= Stages::kManyTurns)) flies_[lane] = 0;
}

// The solved step, to the runs that it belongs to.
void LaneFlight::leave(const std::vector<Integrator*>& runs, int step) {
  for (std::size_t lane = 0; lane < runs.size(); ++lane) {
    if (!flies_[lane]) continue;
    StepsAhead& to = runs[lane]->ahead_;
    double* row = to.part(step, StepsAhead::kQ);
    const double* from = at(step, StepsAhead::kQ) + lane;
    for (int i = 0; i < StepsAhead::kParts * nv_; ++i) row[i] = from[i * width_];
    to.add(iterations_[lane], runs[lane]->iteration_.error());
  }
}

}  // namespace contactvi

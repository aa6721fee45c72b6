#include "step/lane_flight.hpp"

#include <algorithm>
#include <cmath>

#include "model/coupling.hpp"
#include "step/ball_step.hpp"

namespace contactvi {

namespace {

constexpr int kBefore = StartValues::kSteps;
bool is_angle(JointType type) { return type == JointType::kRevolute || type == JointType::kHelical; }

Vec3 three(const double* from, int width) { return Vec3(from[0], from[width], from[2 * width]); }

void put(const Vec3& x, double* to, int width) {
  for (int d = 0; d < 3; ++d) to[d * width] = x[d];
}

}  // namespace

LaneFlight::LaneFlight(const Tree& tree, const FlatModel& model, StageLanes& lanes)
    : lanes_(&lanes),
      nq_(tree.nq),
      nv_(tree.nv),
      width_(StageLanes::most_runs()),
      size_(nq_ * width_),
      turn_(nv_ * width_),
      winds_(nv_),
      steps_(static_cast<std::size_t>(StepsAhead::kMost * StepsAhead::kParts) * size_),
      turned_(size_),
      early_(static_cast<std::size_t>(kArrays) * size_),
      history_(static_cast<std::size_t>(kBefore) * size_),
      weight_(static_cast<std::size_t>(kBefore + 1) * width_),
      q_(size_),
      carry_q_(size_),
      carry_p_(size_),
      error_(width_),
      energy_(width_),
      spare_(static_cast<std::size_t>(StepsAhead::kParts) * nq_),
      rows_(width_),
      judge_(width_, StageIteration(0.0, 0)),
      flies_(width_),
      pending_(width_),
      iterations_(width_),
      followers_(tree.followers) {
  find_dofs(tree, model);
}

void LaneFlight::find_dofs(const Tree& tree, const FlatModel& model) {
  for (std::size_t i = 0; i < tree.joints.size(); ++i) {
    const Joint& joint = tree.joints[i];
    if (joint.type == JointType::kSpherical) {
      // Of the lanes, which outlast the models of the runs.
      balls_.push_back({joint.iq, joint.iv, static_cast<int>(balls_.size()), lanes_->joints_[i].C});
      continue;
    }
    const bool follows = !plain_.empty() && plain_.back().q + plain_.back().count == joint.iq &&
                         plain_.back().v + plain_.back().count == joint.iv;
    if (!follows) plain_.push_back({joint.iq, joint.iv, 0});
    plain_.back().count += joint.nv;
    for (int d = joint.iv; d < joint.iv + joint.nv; ++d) {
      winds_[d] = joint.type == JointType::kRevolute ? 1 : 0;
      // Adding -0 changes no number.
      std::fill_n(turn_.begin() + d * width_, width_, is_angle(joint.type) ? model.joints[i].turn : -0.0);
    }
  }
}

long LaneFlight::fly(const std::vector<Integrator*>& runs) {
  int steps = StepsAhead::kMost;
  for (const Integrator* run : runs) steps = std::min(steps, run->ahead_.wanted());
  board(runs);
  long made = 0;
  for (int step = 0; step < steps; ++step) {
    start_values(step);
    start_stages(step);
    made += iterate();
    stop_far_turns(step);
    finish(step);
    leave(runs, step);
    set_base();
    if (none_flies()) break;
  }
  for (Integrator* run : runs)
    if (!run->ahead_.any()) run->ahead_.pause();
  return made;
}

bool LaneFlight::none_flies() const {
  return std::none_of(flies_.begin(), flies_.end(), [](char flies) { return flies != 0; });
}

// The runs take their lanes with all that their next steps depend on.
void LaneFlight::board(const std::vector<Integrator*>& runs) {
  std::vector<Stages*>& stages = lanes_->boarding_;
  stages.clear();
  for (Integrator* run : runs) stages.push_back(&run->stages_);
  lanes_->seat(stages);
  count_ = static_cast<int>(runs.size());
  for (int lane = 0; lane < width_; ++lane) {
    Integrator& run = *runs[std::min(lane, count_ - 1)];
    lanes_->put(run.q0_.data(), q_.data(), nq_, lane);
    lanes_->put(run.carry_q_.data(), carry_q_.data(), nq_, lane);
    lanes_->put(run.carry_p_.data(), carry_p_.data(), nv_, lane);
    run.start_.weigh(run.h_);
    for (int m = 0; m < kBefore; ++m) {
      lanes_->put(run.start_.history(m).data(), history_.data() + (kBefore - 1 - m) * size_, nv_, lane);
      weight(m)[lane] = run.start_.weight_[m][0];
    }
    weight(kBefore)[lane] = run.stages_.hb()[0];
    judge_[lane] = run.iteration_;
    flies_[lane] = lane < count_ ? 1 : 0;
    if (flies_[lane]) run.ahead_.begin(run.q0_, run.p0_, run.h_, run.iteration_.tol());
  }
}

// The extrapolation of StartValues, in its order.
void LaneFlight::start_values(int step) {
  const double *past[kBefore], *weights[kBefore];
  for (int m = 0; m < kBefore; ++m) {
    const int before = step - 1 - m;
    past[m] = before >= 0 ? at(before, StepsAhead::kV) : history_.data() + (kBefore + before) * size_;
    weights[m] = weight(m);
  }
  lanes_->kernel_->extrapolate(nv_, past, weights, at(step, StepsAhead::kV));
}

// The stages of a step stand where they are kept of it. On spherical joints the first iteration starts from what
// StepEquations::clear_turns does, and measures with the momenta that the step before has left.
void LaneFlight::start_stages(int step) {
  work_ = lanes_->work_;
  work_.v = at(step, StepsAhead::kV);
  work_.X = at(step, StepsAhead::kX);
  work_.P = at(step, StepsAhead::kMomentum);
  work_.G = at(step, StepsAhead::kForce);
  work_.dv = at(step, StepsAhead::kCorrection);
  work_.rate = balls_.empty() ? work_.v : at(step, StepsAhead::kRate);
  work_.Y = turned_.data();
  const double* momenta = step > 0 ? at(step - 1, StepsAhead::kMomentum) : lanes_->P_;
  for (const Ball& ball : balls_) {
    std::fill_n(work_.X + ball.v * width_, 3 * width_, 0.0);
    std::copy_n(momenta + ball.v * width_, 3 * width_, work_.P + ball.v * width_);
  }
}

// Iterates all lanes until the last one is done. What a lane would have alone is put aside where it is done earlier.
long LaneFlight::iterate() {
  long made = 0;
  int flags = 0;
  pending_ = flies_;
  early_lanes_.clear();
  for (int lane = 0; lane < count_; ++lane) {
    if (!flies_[lane]) continue;
    iterations_[lane] = 0;
    judge_[lane].begin(false);
    flags = judge_[lane].flags();
  }
  for (auto left = std::count(pending_.begin(), pending_.end(), 1); left > 0;) {
    lanes_->kernel_->iterate(&lanes_->tree_, &work_, flags);
    flags &= ~(kLaneFactor | kLaneFirst);
    made += left;
    done_.clear();
    measure();
    for (int lane = 0; lane < count_; ++lane) {
      if (!pending_[lane]) continue;
      StageIteration& own = judge_[lane];
      own.judge(error_[lane], energy_[lane]);
      ++iterations_[lane];
      if (own.goes_on() && (own.flags() & (kLaneFactor | kLaneNewton)) == 0 && !own.accelerates()) continue;
      pending_[lane] = 0;
      flies_[lane] = own.solved() ? 1 : 0;
      --left;
      if (flies_[lane]) done_.push_back(lane);
    }
    if (left == 0) break;
    for (int lane : done_) {
      copy_stages(lane, true);
      early_lanes_.push_back(lane);
    }
  }
  for (int lane : early_lanes_) copy_stages(lane, false);
  return made;
}

// The relative errors and energies of all lanes.
void LaneFlight::measure() {
  const double *error = lanes_->per_stage_, *kinetic = error + width_, *impulses = kinetic + width_;
  double* __restrict relative = error_.data();
  double* __restrict energy = energy_.data();
  for (int lane = 0; lane < width_; ++lane) {
    relative[lane] = std::sqrt(StageIteration::squared_error(error[lane], kinetic[lane], impulses[lane]));
    energy[lane] = StageIteration::largest_energy(kinetic[lane], impulses[lane]);
  }
}

// Of one lane: puts the stages aside, or back.
void LaneFlight::copy_stages(int lane, bool aside) {
  double* arrays[kArrays] = {work_.v, work_.X, work_.P, work_.G, work_.dv, work_.rate, work_.Y};
  for (int k = 0; k < (balls_.empty() ? kArrays - 2 : kArrays); ++k) {
    double* spare = early_.data() + k * size_;
    const double* from = aside ? arrays[k] : spare;
    double* to = aside ? spare : arrays[k];
    for (int d = lane; d < nv_ * width_; d += width_) to[d] = from[d];
  }
}

// Integrator::turns_too_far, with the rates of the last iteration.
void LaneFlight::stop_far_turns(int step) {
  const double *weight = this->weight(kBefore), *rate = at(step, StepsAhead::kRate);
  for (const Ball& ball : balls_)
    for (int lane = 0; lane < count_; ++lane) {
      if (!flies_[lane]) continue;
      double turn2 = 0.0;
      for (int d = 0; d < 3; ++d) {
        const double X = weight[lane] * rate[(ball.v + d) * width_ + lane];
        turn2 += X * X;
      }
      if (!(turn2 <= Integrator::kFarTurn * Integrator::kFarTurn)) flies_[lane] = 0;
    }
}

// StepEquations::finish, lane by lane.
void LaneFlight::finish(int step) {
  const RunKernel& kernel = *lanes_->kernel_;
  finish_balls(step);
  for (const Plain& dofs : plain_) {
    const int q = dofs.q * width_, v = dofs.v * width_;
    kernel.add(dofs.count, weight(kBefore), work_.G + v, lanes_->p0_ + v, carry_p_.data() + v,
               at(step, StepsAhead::kP) + v, at(step, StepsAhead::kCarryP) + v);
    kernel.add(dofs.count, weight(kBefore), work_.v + v, q_.data() + q, carry_q_.data() + q,
               at(step, StepsAhead::kQ) + q, at(step, StepsAhead::kCarryQ) + q);
  }
  finish_followers(step);
}

// fold_momentum and follow_configuration, lane by lane.
void LaneFlight::finish_followers(int step) {
  const auto each = [&](double* array, int number, auto&& change) {
    for (int lane = 0; lane < width_; ++lane) change(array[number * width_ + lane], array + lane);
  };
  for (const Follower& f : followers_) {
    for (double* p : {lanes_->p0_, at(step, StepsAhead::kP), carry_p_.data(), at(step, StepsAhead::kCarryP)})
      each(p, f.iv, [&](double& own, double* all) {
        for (const Follower::Leader& leader : f.leaders) all[leader.iv * width_] += leader.ratio * own;
        own = 0.0;
      });
    for (double* q : {q_.data(), at(step, StepsAhead::kQ)})
      each(q, f.iq, [&](double& own, double* all) {
        double value = f.offset;
        for (const Follower::Leader& leader : f.leaders) value += leader.ratio * all[leader.iq * width_];
        own = value;
      });
    for (double* carry : {carry_q_.data(), at(step, StepsAhead::kCarryQ)})
      each(carry, f.iq, [](double& own, double*) { own = 0.0; });
  }
}

// Sums on quaternions lose no digits that are carried.
void LaneFlight::finish_balls(int step) {
  if (balls_.empty()) return;
  const double *weight = this->weight(kBefore), *rate = work_.rate;
  lanes_->kernel_->rates(&lanes_->tree_, &work_);
  for (const Ball& ball : balls_)
    for (int lane = 0; lane < count_; ++lane) {
      if (!flies_[lane]) continue;
      const int at_q = ball.q * width_ + lane, at_v = ball.v * width_ + lane;
      double *q = q_.data() + at_q, *p = lanes_->p0_ + at_v;
      const Vec3 X1 = weight[lane] * three(rate + at_v, width_),
                 impulses = weight[lane] * three(turned_.data() + at_v, width_);
      const Vec3 p1 = end_ball_momentum(X1, three(p, width_) + impulses);
      const Quat q1 = end_ball(Quat(q[3 * width_], q[0], q[width_], q[2 * width_]), X1);
      for (int d = 0; d < 4; ++d) {
        q[d * width_] = at(step, StepsAhead::kQ)[at_q + d * width_] = q1.coeffs()[d];
        at(step, StepsAhead::kCarryQ)[at_q + d * width_] = 0.0;
      }
      put(p1, p, width_);
      put(p1, at(step, StepsAhead::kP) + at_v, width_);
      put(Vec3::Zero(), at(step, StepsAhead::kCarryP) + at_v, width_);
    }
}

// Stages::set_base, for angles from which no revolutions are taken off: others end the flight.
void LaneFlight::set_base() {
  bool far = false;
  for (const Plain& dofs : plain_) {
    double* __restrict base = lanes_->base_ + dofs.v * width_;
    const double *q = q_.data() + dofs.q * width_, *turn = turn_.data() + dofs.v * width_;
    for (int i = 0; i < dofs.count * width_; ++i) {
      base[i] = q[i] + turn[i];
      far |= !(std::abs(base[i]) <= Stages::kManyTurns);
    }
  }
  for (const Ball& ball : balls_)
    for (int lane = 0; lane < count_; ++lane) {
      if (!flies_[lane]) continue;
      const double* q = q_.data() + ball.q * width_ + lane;
      double base[9];
      start_ball(ball.C, Quat(q[3 * width_], q[0], q[width_], q[2 * width_]), base);
      for (int i = 0; i < 9; ++i) lanes_->ball_base_[(9 * ball.base + i) * width_ + lane] = base[i];
    }
  if (!far) return;
  for (int d = 0; d < nv_; ++d)
    for (int lane = 0; lane < count_; ++lane)
      if (winds_[d] && !(std::abs(lanes_->base_[d * width_ + lane]) <= Stages::kManyTurns)) flies_[lane] = 0;
}

// The solved step, to the runs that it belongs to.
void LaneFlight::leave(const std::vector<Integrator*>& runs, int step) {
  const int numbers = runs[0]->ahead_.numbers();
  for (int lane = 0; lane < width_; ++lane) {
    rows_[lane] = spare_.data();
    if (!flies_[lane]) continue;
    StepsAhead& to = runs[lane]->ahead_;
    rows_[lane] = to.part(step, StepsAhead::kQ);
    to.add(iterations_[lane], judge_[lane].error());
  }
  constexpr int together = 4;  // lanes, of which there are so many or twice that
  for (int lane = 0; lane < width_; lane += together) {
    const double* from = at(step, StepsAhead::kQ) + lane;
    double *a = rows_[lane], *b = rows_[lane + 1], *c = rows_[lane + 2], *d = rows_[lane + 3];
    for (int i = 0; i < numbers; ++i, from += width_) {
      a[i] = from[0];
      b[i] = from[1];
      c[i] = from[2];
      d[i] = from[3];
    }
  }
}

}  // namespace contactvi

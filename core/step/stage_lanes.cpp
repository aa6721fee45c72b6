#include "step/stage_lanes.hpp"

#include <algorithm>
#include <cstring>

namespace contactvi {

StageLanes::StageLanes(const FlatModel& model)
    : joints_(model.joints),
      followers_(model.followers),
      leaders_(model.leaders),
      couplings_(model.couplings),
      terms_(model.terms),
      path_(model.path),
      tree_(model.lanes),
      kernel_(&run_kernel()),
      work_{},
      memory_(0),
      steps_(kernel_->lanes) {
  tree_.joint = joints_.data();
  tree_.follower = followers_.data();
  tree_.leader = leaders_.data();
  tree_.coupling = couplings_.data();
  tree_.term = terms_.data();
  tree_.path = path_.data();
  const std::size_t S = kernel_->lanes, n = tree_.nv * S, balls = tree_.balls > 0 ? n : 0;
  const std::pair<double**, std::size_t> arrays[] = {{&X_, n},
                                                     {&v_, n},
                                                     {&P_, n},
                                                     {&G_, n},
                                                     {&dv_, n},
                                                     {&magnitude_, n},
                                                     {&diagonal_, n},
                                                     {&base_, n},
                                                     {&p0_, n},
                                                     {&stiffness_, n},
                                                     {&deflection_, n},
                                                     {&damping_, n},
                                                     {&tau_, n},
                                                     {&rate_, balls},
                                                     {&Y_, balls},
                                                     {&px_, balls},
                                                     {&ball_base_, 9 * tree_.balls * S},
                                                     {&per_stage_, 3 * S},
                                                     {&tableau_, 5 * S},
                                                     {&work_.storage, tree_.storage * S},
                                                     {&work_.slots, 36 * std::max(1, tree_.slots) * S},
                                                     {&work_.coupled, 2 * coupled_rows(tree_) * S}};
  std::size_t total = 0;
  for (const auto& array : arrays) total += (array.second + 7) / 8 * 8;
  memory_ = AlignedArray(total);
  double* at = memory_.data();
  for (const auto& array : arrays) {
    *array.first = at;
    at += (array.second + 7) / 8 * 8;
  }
  work_.s = 1;
  work_.S = kernel_->lanes;
  work_.hA = tableau_;
  work_.hb = tableau_ + S;
  work_.he = tableau_ + 2 * S;
  work_.he_turn = tableau_ + 3 * S;
  work_.run_h = tableau_ + 4 * S;
  work_.base = base_;
  work_.ball_base = ball_base_;
  work_.p0 = p0_;
  work_.deflection = deflection_;
  work_.damping = damping_;
  work_.X = X_;
  work_.v = v_;
  work_.rate = tree_.balls > 0 ? rate_ : v_;
  work_.P = P_;
  work_.G = G_;
  work_.Y = Y_;
  work_.px = px_;
  work_.dv = dv_;
  work_.magnitude = magnitude_;
  work_.diagonal = diagonal_;
  work_.error = per_stage_;
  work_.kinetic = per_stage_ + S;
  work_.impulse_energy = per_stage_ + 2 * S;
  work_.context = this;
}

namespace {

// Whether a list has the same bytes as another one.
template <class T>
bool same(const std::vector<T>& a, const std::vector<T>& b) {
  return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(T)) == 0);
}

}  // namespace

bool StageLanes::fits(const FlatModel& model) const {
  return model.lanes.nv == tree_.nv && same(model.joints, joints_) && same(model.followers, followers_) &&
         same(model.couplings, couplings_) && same(model.terms, terms_);
}

int StageLanes::kind(const Stages& step) {
  const LaneWork& w = step.work_;
  return (w.stiffness != nullptr ? 1 : 0) | (w.tau != nullptr ? 2 : 0) | (w.extra != nullptr ? 4 : 0);
}

void StageLanes::put(const double* from, double* to, int count, int lane) const {
  for (int i = 0; i < count; ++i) to[i * work_.S + lane] = from[i];
}

void StageLanes::get(const double* from, double* to, int count, int lane) const {
  for (int i = 0; i < count; ++i) to[i] = from[i * work_.S + lane];
}

void StageLanes::spread(double* Stages::* from, double* to, int count) const {
  for (int lane = 0; lane < work_.S; ++lane) put(steps_[lane]->*from, to, count, lane);
}

// Lanes without a step repeat the last one, so that nothing in them divides by zero.
void StageLanes::assign(const std::vector<Stages*>& steps) {
  for (int lane = 0; lane < work_.S; ++lane) steps_[lane] = steps[std::min<std::size_t>(lane, steps.size() - 1)];
}

void StageLanes::solve_masses(const std::vector<Stages*>& steps) {
  const int n = tree_.nv;
  assign(steps);
  spread(&Stages::X_, X_, n);
  spread(&Stages::dv_, dv_, n);
  spread(&Stages::diagonal_, diagonal_, n);
  spread(&Stages::base_, base_, n);
  if (tree_.balls > 0) spread(&Stages::ball_base_, ball_base_, 9 * tree_.balls);
  kernel_->solve(&tree_, &work_);
  for (std::size_t lane = 0; lane < steps.size(); ++lane) get(dv_, steps[lane]->dv_, n, static_cast<int>(lane));
}

void StageLanes::seat(const std::vector<Stages*>& steps) {
  const int n = tree_.nv, S = work_.S;
  assign(steps);
  const LaneWork& first = steps_[0]->work_;
  work_.stiffness = first.stiffness != nullptr ? stiffness_ : nullptr;
  work_.tau = first.tau != nullptr ? tau_ : nullptr;
  work_.extra = first.extra != nullptr ? &StageLanes::add_extra : nullptr;
  spread(&Stages::v_, v_, n);
  spread(&Stages::diagonal_, diagonal_, n);
  spread(&Stages::base_, base_, n);
  spread(&Stages::p0_, p0_, n);
  spread(&Stages::per_stage_, per_stage_, 3);
  if (tree_.balls > 0) {
    spread(&Stages::ball_base_, ball_base_, 9 * tree_.balls);
    spread(&Stages::X_, X_, n);
    spread(&Stages::P_, P_, n);
  }
  if (work_.stiffness != nullptr) {
    spread(&Stages::stiffness_, stiffness_, n);
    spread(&Stages::deflection_, deflection_, n);
    spread(&Stages::damping_, damping_, n);
  }
  if (work_.tau != nullptr) spread(&Stages::input_, tau_, n);
  for (int lane = 0; lane < S; ++lane) {
    const LaneWork& w = steps_[lane]->work_;
    const double numbers[5] = {w.hA[0], w.hb[0], w.he[0], w.he_turn[0], w.h};
    put(numbers, tableau_, 5, lane);
  }
  std::fill(steps_.begin() + static_cast<std::ptrdiff_t>(steps.size()), steps_.end(), nullptr);
}

void StageLanes::iterate(int flags) { kernel_->iterate(&tree_, &work_, flags); }

void StageLanes::fetch_numbers(int lane) { get(per_stage_, steps_[lane]->per_stage_, 3, lane); }

void StageLanes::fetch(int lane) {
  Stages& step = *steps_[lane];
  const int n = tree_.nv;
  get(v_, step.v_, n, lane);
  get(X_, step.X_, n, lane);
  get(P_, step.P_, n, lane);
  get(G_, step.G_, n, lane);
  get(dv_, step.dv_, n, lane);
  if (tree_.balls > 0) {
    get(rate_, step.rate_, n, lane);
    get(Y_, step.Y_, n, lane);
  }
  steps_[lane] = nullptr;
}

void StageLanes::fetch_correction(int lane) {
  Stages& step = *steps_[lane];
  get(v_, step.v_, tree_.nv, lane);
  get(dv_, step.dv_, tree_.nv, lane);
  get(magnitude_, step.magnitude_, tree_.nv, lane);
}

void StageLanes::put_velocity(int lane) { put(steps_[lane]->v_, v_, tree_.nv, lane); }

void StageLanes::add_extra(void* self) { static_cast<StageLanes*>(self)->add_forces(); }

void StageLanes::add_forces() {
  const int n = tree_.nv;
  for (int lane = 0; lane < work_.S; ++lane) {
    if (steps_[lane] == nullptr) continue;
    Stages& step = *steps_[lane];
    get(v_, step.v_, n, lane);
    get(X_, step.X_, n, lane);
    get(G_, step.G_, n, lane);
    get(magnitude_, step.magnitude_, n, lane);
    step.add_forces();
    put(step.G_, G_, n, lane);
    put(step.magnitude_, magnitude_, n, lane);
  }
}

}  // namespace contactvi

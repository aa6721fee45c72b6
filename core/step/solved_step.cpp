#include "step/solved_step.hpp"

#include <algorithm>

namespace contactvi {

SolvedStep::SolvedStep(const Tree& tree, int stages)
    : tree_(&tree), model_(tree), stages_(tree, model_, stages), stiff_(tree, stages_), q0_(tree.nq), p0_(tree.nv) {}

void SolvedStep::take(const VecX& q0, const VecX& p0, double h, const VecX& tau, double time, const Servo* servo,
                      const MatX& velocities) {
  q0_ = q0;
  p0_ = p0;
  tau_ = tau;
  time_ = time;
  stages_.set_servo(servo);
  stages_.set_time(time);
  stages_.begin(q0_, p0_, h, tau_);
  const int S = stages_.padded(), s = stages_.count();
  for (int d = 0; d < tree_->nv; ++d)
    for (int i = 0; i < S; ++i) stages_.v()[d * S + i] = velocities(d, std::min(i, s - 1));
  std::fill_n(stages_.X(), tree_->nv * S, 0.0);
  stages_.settle();
  stages_.evaluate_with_forces();
  stages_.factor();
  if (stiff_.any()) stiff_.factor(stages_, q0_);
}

void SolvedStep::copy_to(Stages& other) const {
  other.set_servo(stages_.servo());
  other.set_time(time_);
  other.begin(q0_, p0_, stages_.length(), tau_);
  const int size = tree_->nv * stages_.padded();
  std::copy_n(stages_.v(), size, other.v());
  std::copy_n(stages_.X(), size, other.X());
}

void SolvedStep::solve() {
  stages_.solve();
  if (stiff_.any()) stiff_.correct_solution(stages_, false);
}

void SolvedStep::solve_transposed() {
  stages_.solve();
  if (stiff_.any()) stiff_.correct_solution(stages_, true);
}

}  // namespace contactvi

#include "sensitivity/step_masses.hpp"

#include <algorithm>
#include <cmath>

#include "base/differences.hpp"
#include "base/error.hpp"

namespace contactvi {

namespace {
constexpr double kMove = 1e-3;     // [rad; m] over which differences are taken
constexpr double kStretch = 1e-2;  // at most, of the length
}  // namespace

StepMasses::StepMasses(const Scene& scene) : scene_(&scene), integrator_(scene.tree), rows_(scene) {
  const BlockProblem& problem = rows_.problem();
  for (int b = 0; b < problem.blocks(); ++b) largest_ = std::max(largest_, problem.size(b));
}

template <class Visit>
void StepMasses::each_block(Visit visit) const {
  const BlockProblem& problem = rows_.problem();
  for (int b = 0; b < problem.blocks(); ++b) visit(b, problem.start[b], problem.size(b));
}

// Adds the masses, block under block, where in each block one degree of freedom has changed.
void StepMasses::add(Of of, int dof, double change, double weight, MatX& D) {
  const Tree& tree = scene_->tree;
  VecX moved = VecX::Zero(tree.nv), q0 = step_->q0, v0 = v0_, v = step_->places[0].v;
  each_block([&](int, int first, int size) {
    if (dof < size) moved[first + dof] = change;
  });
  const double h = step_->h + (of == kLength ? change : 0.0);
  if (of == kStart) integrate(tree, step_->q0, moved, 1.0, q0);
  if (of == kStartVelocity) v0 += moved;
  if (of == kVelocity) v += moved;
  integrator_.begin(q0, h, tau_, v0);
  VecX now(tree.nv);
  bool good = std::isfinite(integrator_.iterate(step_->p0, true, true));
  integrator_.stage_velocity(now);
  integrator_.add_velocity(v - now);
  good = good && std::isfinite(integrator_.iterate(step_->p0, false, false));
  if (!good) throw Error("the masses of a recorded step are not finite");
  rows_.set_masses([this](MatX& X) { integrator_.solve_step_matrix(X); });
  each_block([&](int b, int first, int size) { D.block(first, 0, size, size) += weight * rows_.problem().M[b]; });
}

void StepMasses::take(const DenseStepRecord& step, const VecX& tau, const Servo* servo, const VecX& v0) {
  step_ = &step;
  tau_ = tau;
  v0_ = v0;
  integrator_.set_time(step.t);
  integrator_.set_servo(servo);
  const double speed = std::max(v0.cwiseAbs().maxCoeff(), step.places[0].v.cwiseAbs().maxCoeff());
  const double over[] = {kMove, 2.0 * kMove / step.h, 2.0 * kMove / step.h,
                         std::min(kStretch * step.h, 2.0 * kMove / (speed + 1e-300))};
  changes_.assign(static_cast<std::size_t>(3 * largest_ + 1), MatX::Zero(scene_->tree.nv, largest_));
  for (int k = 0; k < 3 * largest_ + 1; ++k) {
    const Of of = static_cast<Of>(k / largest_);
    for (const auto& [count, weight] : kDifference)
      add(of, k % largest_, count * over[of], weight / (kDifferenceParts * over[of]), changes_[k]);
  }
}

MatX StepMasses::effect(const VecX& u) const {
  const int n = scene_->tree.nv;
  MatX found = MatX::Zero(n, 3 * n + 1);
  each_block([&](int, int first, int size) {
    for (int of = 0; of < 3; ++of)
      for (int d = 0; d < size; ++d)
        found.col(of * n + first + d).segment(first, size) =
            changes_[of * largest_ + d].block(first, 0, size, size) * u.segment(first, size);
    found.col(3 * n).segment(first, size) = changes_.back().block(first, 0, size, size) * u.segment(first, size);
  });
  return found;
}

}  // namespace contactvi

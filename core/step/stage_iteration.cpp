#include "step/stage_iteration.hpp"

namespace contactvi {

void StageIteration::judge(const Stages& stages, double rounding) {
  double scale = std::numeric_limits<double>::infinity();  // of the stage in which rounding counts most
  for (int i = 0; i < stages.count(); ++i)
    scale = std::min(scale, std::max(largest_energy(stages.kinetic(i), stages.impulse_energy(i)), rounding));
  floor_ = std::sqrt(rounding / scale);
  judge(stages);
}

void StageIteration::judge(const Stages& stages) {
  if (stages.count() == 1) {
    const double kinetic = stages.kinetic(0), impulses = stages.impulse_energy(0);
    judge(std::sqrt(squared_error(stages.error(0), kinetic, impulses)), largest_energy(kinetic, impulses), true);
    return;
  }
  double worst = 0.0, energy = 0.0;
  for (int i = 0; i < stages.count(); ++i) {
    const double kinetic = stages.kinetic(i), impulses = stages.impulse_energy(i);
    const double squared = squared_error(stages.error(i), kinetic, impulses);
    worst =
        std::isnan(worst) || std::isnan(squared) ? std::numeric_limits<double>::quiet_NaN() : std::max(worst, squared);
    energy = std::max(energy, largest_energy(kinetic, impulses));
  }
  judge(std::sqrt(worst), energy, stages.count() <= kNewtonStages);
}

}  // namespace contactvi

#include "step/stage_force_rates.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

const MatX& StageForceRates::of(SolvedStep& step) {
  if (known_) return rates_;
  Stages& stages = step.stages();
  const int n = tree_->nv, S = stages.padded();
  VecX q(tree_->nq), v(n);
  rates_.resize(n, stages.count());
  for (int i = 0; i < stages.count(); ++i) {
    double scale = 0.0;
    stages.configuration(step.q0(), i, q);
    for (int d = 0; d < n; ++d) {
      v[d] = stages.v()[d * S + i];
      scale = std::max(scale, std::abs(stages.G()[d * S + i]));
    }
    force_rate(field_, stages.time(i), stages.time(i) - step.time(), q, v, scale, rates_.col(i));
  }
  known_ = true;
  return rates_;
}

}  // namespace contactvi

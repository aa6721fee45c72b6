// What a run did where its motion has a kink: along a direction that leads to both sides the derivative is that of the
// branch that was taken, an element of the generalised derivative (Clarke, "Optimization and nonsmooth analysis",
// 1983), or there is none, by choice.
#pragma once

#include <vector>

#include "base/no_derivative.hpp"

namespace contactvi {

// Of the effect of all impulses, or of a momentum: what has less is rounding, from what points share.
constexpr double kShared = 1e-7;
// Of the impulses and speeds: nearer to a change of an active set rounding decides what happens.
constexpr double kOnCone = 1e-9;

class Kinks {
 public:
  explicit Kinks(bool taken) : taken_(taken) {}
  bool taken() const { return taken_; }
  // Throws the obstacle, or notes where it was.
  void meet(const NoDerivative& obstacle) {
    const Obstacle& at = obstacle.where;
    if (!taken_) throw NoDerivative(at, obstacle.what(), obstacle.expected, obstacle.got, obstacle.remedy);
    if (!met_.empty() && met_.back().time == at.time && met_.back().guard == at.guard) return;
    met_.push_back(at);
  }
  // Those met so far.
  const std::vector<Obstacle>& met() const { return met_; }

 private:
  bool taken_;
  std::vector<Obstacle> met_;
};

}  // namespace contactvi

// The derivative of an impact by Poisson's law: of the two cone problems of compression and expansion (ImpactBlock),
// with the active sets of their solutions.
//
// With the speeds gamma- of the rows before the impact and the Delassus matrix G, each problem has the speeds
// gamma = gamma_0 + G Lambda, gamma_0 = gamma- at first and gamma- + G Lambda_1 then, and at each point
//   open:   dLambda = 0;      loaded: dgamma_n = 0, or dLambda_n = d(e Lambda_1n) where that is the least it may be;
//   sticks: dgamma_t = 0;     slips:  d(Lambda_t + mu Lambda_n s / |s|) = 0, s the slip gamma_t,
// with the spin where that has friction, and the same for rolling (friction_rows.hpp).
// Where several points share a load the impulses are those of least norm.
#pragma once

#include <vector>

#include "sensitivity/friction_rows.hpp"
#include "sensitivity/shared_load.hpp"

namespace contactvi {

// A point of an impact: its first row and how many it has, 1 without friction and 3 or more with.
struct ImpactPoint {
  int row, rows;
  double e, mu;
};

// A direction in all that the problems depend on.
struct PoissonDirection {
  VecX gamma;  // of gamma-, (rows,)
  MatX G;      // (rows, rows)
  VecX e, mu;  // of the points
  VecX size;   // of the terms of gamma, (rows,): rounding is relative to it
};

class PoissonTangent {
 public:
  // gamma: before the impact, (rows,); first, lambda: impulses of the compression and of both problems.
  void take(const std::vector<ImpactPoint>& points, const VecX& gamma, const MatX& G, const VecX& first,
            const VecX& lambda);
  // Distance from the nearest change between sticking and slipping, relative to the impulses or the speeds.
  double margin() const { return margin_; }
  // Whether all motions, of which `effect` (n, rows) are those by the impulses, are determined however points share a
  // load.
  bool determines(const MatX& effect) const;
  // kKink: a point that neither closes nor separates, without an impulse, does so along the direction.
  // kContradiction: points that share a load contradict each other along it. dlambda is linear in the direction all the
  // same.
  enum class Outcome { kSolved, kKink, kContradiction };
  Outcome solve(const PoissonDirection& direction, VecX& dlambda) const;

 private:
  enum class Mode { kOpen, kBorder, kLoaded };
  // Friction against a slip that a point has.
  struct Slip {
    std::size_t point;
    FrictionRows rows;
    double mu;
  };
  struct Phase {
    bool any = false;
    std::vector<Mode> modes;
    std::vector<Slip> slips;
    std::vector<char> at_least;  // whether the normal impulse is the least that it may be
    VecX lambda, gamma;
    SharedLoad system;
  };

  void set_phase(Phase& phase, const VecX& least);
  Outcome solve(const Phase& phase, const VecX& dgamma0, const VecX& dleast, const PoissonDirection& direction,
                VecX& dlambda) const;

  std::vector<ImpactPoint> points_;
  MatX G_;
  Phase compression_, expansion_;
  double margin_ = 1.0;
  double speed_ = 0.0, impulse_ = 0.0;
};

}  // namespace contactvi

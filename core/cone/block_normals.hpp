// Stage D: the normal impulses for tangential impulses and joint friction that stay,
//
//   lambda_n >= low = max(lower, |lambda_t|/mu),  w_n >= 0,  (lambda_n - low) w_n = 0     (lambda_t with the spin;
//                                                                                       low >= |lambda_roll|)
//
// a convex quadratic problem. For offset >= 0 it has a solution whatever the redundancy and the friction, since v = 0
// has no gap that closes; where it has none, the gaps are given a small compliance.
#pragma once

#include <vector>

#include "cone/block_factor.hpp"
#include "cone/block_system.hpp"

namespace contactvi {

class BlockNormals {
 public:
  // point: start on entry, the answer on return, its tangential impulses inside the friction that its normals allow.
  // tolerance: of the natural map of this problem over the scale of speeds. From a start with few changes some sweeps
  // are enough; else semismooth Newton steps, then an interior point. Returns the factorizations used.
  int run(const BlockSystem& system, BlockFactor& factor, double tolerance, int iterations, ConePoint& point);
  double residual() const { return best_residual_; }

 private:
  struct Pair {
    double n, s;       // impulse above low, normal velocity
    double error;      // velocity that belongs to the impulses minus s
    double d, dn, ds;  // step; dn without its share of ds
    double corrector;
  };
  void begin(const BlockSystem& system, ConePoint& point);
  void sweep(const BlockSystem& system, ConePoint& point) const;
  double evaluate(const BlockSystem& system, const ConePoint& point) const;
  bool keep(const BlockSystem& system, const ConePoint& point);
  bool newton_step(const BlockSystem& system, BlockFactor& factor, ConePoint& point);
  int newton(const BlockSystem& system, BlockFactor& factor, double tolerance, int steps, ConePoint& point);
  void start_path(const BlockSystem& system, double tolerance);
  int follow_path(const BlockSystem& system, BlockFactor& factor, double goal, double compliance, int iterations);
  int soften(const BlockSystem& system, BlockFactor& factor, double tolerance, int iterations, ConePoint& point);
  bool advance(const BlockSystem& system, BlockFactor& factor, double compliance);
  double direction(const BlockSystem& system, BlockFactor& factor, double target, bool corrected);

  std::vector<double> low_;  // per contact
  std::vector<Pair> pairs_;
  std::vector<double> weight_;  // of d s in d n
  std::vector<Mat3> K_;
  VecX step_;
  ConePoint best_, trial_;
  double best_residual_ = 0.0, mean_ = 0.0;
};

}  // namespace contactvi

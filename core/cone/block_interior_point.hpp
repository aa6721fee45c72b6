// Stage C: the convex problem that the law becomes when the slip speeds s of De Saxce's correction are frozen,
//
//   min |v - v_free|^2_M / 2   with   (w_n + offset + mu s, w_t) in the dual of the friction cone
//
// by a primal-dual interior point with Nesterov and Todd's scaling and Mehrotra's predictor and corrector (the scaling
// of second-order cones as in Vandenberghe, "The CVXOPT linear and quadratic cone program solvers", 2010). Lower bounds
// of impulses have no place in it; joint friction keeps the impulses it has.
#pragma once

#include <vector>

#include "cone/block_factor.hpp"
#include "cone/block_system.hpp"

namespace contactvi {

class BlockInteriorPoint {
 public:
  // slip: s per contact [m/s]; start: distance from the central path at which the iteration starts, as a share of the
  // scale of speeds; tolerance: of the residual of the convex problem, over that scale. point: start on entry, the best
  // on return. Returns the factorizations used, at most `iterations`.
  int run(const BlockSystem& system, BlockFactor& factor, const std::vector<double>& slip, double start,
          double tolerance, int iterations, BlockPoint& point);
  double residual() const { return residual_; }  // of the convex problem at the returned point

 private:
  // One contact, in coordinates (mu lambda_n, lambda_t) and (w_n/mu + s, w_t).
  struct Pair {
    Vec3 z = Vec3::Zero(), s = Vec3::Zero();                      // impulse and velocity, both inside the cone
    Vec3 error = Vec3::Zero();                                    // velocity that belongs to the impulses minus s
    Vec3 dz = Vec3::Zero(), ds = Vec3::Zero(), d = Vec3::Zero();  // step; dz without its share of ds
    Vec3 corrector = Vec3::Zero();                                // product of the predictor's steps
    Mat3 scaling = Mat3::Zero(), inverse = Mat3::Zero();          // Nesterov and Todd's
  };

  void begin(const BlockSystem& system, double start);
  Vec3 dual_velocity(const BlockSystem& system, int c, const VecX& v) const;
  bool prepare(const BlockSystem& system, BlockFactor& factor);
  double direction(const BlockSystem& system, BlockFactor& factor, double target, bool corrected);
  double advance(const BlockSystem& system, BlockFactor& factor);
  double convex_residual(const BlockSystem& system, const BlockPoint& point) const;
  void impulses(const BlockSystem& system, BlockPoint& point) const;

  const std::vector<double>* slip_ = nullptr;
  std::vector<Pair> pairs_;
  std::vector<double> mu_;  // stretch of the normal; 1 without friction
  std::vector<Mat3> K_;
  VecX step_;
  BlockPoint trial_;
  double mean_ = 0.0;  // of z.s per contact [J]
  double residual_ = 0.0;
};

}  // namespace contactvi

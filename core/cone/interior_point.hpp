// An interior point method for the whole law of contact and friction, of block_problem.hpp and problem.hpp.
//
// With De Saxce's correction the law says that impulse and velocity lie in a cone and its dual and are complementary,
//
//   z = (mu lambda_n, lambda_t) in K,   y = (w_n/mu + |w_t|, w_t) in K,   z.y = 0,   K: x_n >= |x_t|
//
// but for the term |w_t| the conditions of a convex problem. The method is the primal-dual one for that problem, with
// Nesterov and Todd's scaling and Mehrotra's predictor and corrector (the scaling of second-order cones as in
// Vandenberghe, "The CVXOPT linear and quadratic cone program solvers", 2010). The term is evaluated at each iterate,
// and where mu is large only a share of its derivative (kCoupling) stands in the matrix: with all of it steps are
// blocked at the boundary, without it they go on as slowly as a fixed point iteration. Bounds of a
// single impulse, of Poisson's expansion and of joint friction, are pairs of numbers beside that of the cone.
#pragma once

#include <vector>

#include "cone/block_law.hpp"

namespace contactvi {

// System and Factor: BlockSystem and BlockFactor, or DenseSystem and DenseFactor.
template <class System, class Factor>
class InteriorPoint {
 public:
  // What the slip speed |w_t| in the law is: that of the iterate, or a given one per contact, with which the problem is
  // convex.
  using Frozen = const std::vector<double>*;

  // At most `iterations` iterations, until the residual is `tolerance`; of the whole law, or of the convex problem. It
  // starts from the least impulses: what failed before may press contacts against each other by far more than the
  // answer does, and such impulses lie along the boundary where steps are blocked. point: the best on return, unless
  // none was better than on entry (point.residual). Returns the factorizations used.
  int run(const System& system, Factor& factor, Frozen frozen, double tolerance, int iterations, ConePoint& point);

 private:
  // One bound of an impulse.
  struct Bound {
    bool present = false;
    double room = 0.0, force = 0.0;               // distance from the bound, and the velocity that keeps it
    double d = 0.0, d_room = 0.0, d_force = 0.0;  // step; d: that of the force without its share of the room's
    double corrector = 0.0;
  };
  // One contact, in coordinates (mu lambda_n, lambda_t) and (w_n/mu + |w_t|, w_t).
  struct Pair {
    bool cone = false;
    double mu = 1.0;                            // stretch of the normal
    Vec3 z = Vec3::Zero(), y = Vec3::Zero();    // impulse and velocity, both inside the cone
    Vec3 slip = Vec3::Zero();                   // share of the derivative of |w_t|
    Vec3 error = Vec3::Zero();                  // velocity that belongs to the impulses minus those of the pairs
    Vec3 dz = Vec3::Zero(), dy = Vec3::Zero();  // step
    Vec3 d = Vec3::Zero();                      // of all pairs: step of the velocity at the present impulses
    Vec3 corrector = Vec3::Zero();              // product of the predictor's steps
    Mat3 scaling = Mat3::Zero(), inverse = Mat3::Zero();  // Nesterov and Todd's
    Mat3 mobility = Mat3::Zero();                         // impulse over velocity: inverse of the sum over the pairs
    Bound lower, upper;
  };

  void begin(const System& system);
  void begin_bounds(const BlockContact& law, double g, double t, double lambda, double w, Pair& p) const;
  void read_velocities(const System& system);
  void set_scaling(Pair& p) const;
  void impulses(const System& system);
  bool prepare(const System& system, Factor& factor);
  double direction(const System& system, Factor& factor, double target, bool corrected);
  bool advance(const System& system, Factor& factor);
  double residual(const System& system, const ConePoint& point) const;

  Frozen frozen_ = nullptr;
  std::vector<Pair> pairs_;
  std::vector<Mat3> K_;
  VecX step_;
  ConePoint iterate_, projected_;
  double mean_ = 0.0;  // of the products of a pair [J]
};

}  // namespace contactvi

// Impacts with friction or with several points at once: Poisson's restitution as two cone problems.
//
//   compression  gamma_1 = gamma + G Lambda_1, e = 0 with Coulomb's law (maximal dissipation);
//   expansion    gamma+ = gamma_1 + G Lambda_2,  Lambda_2n >= e Lambda_1n, gamma+_n >= 0, complementary, Coulomb again.
// All points of a pair are one impact, so that a box that falls flat rises without turning. Newton's e on the normal
// speed with Coulomb friction can gain energy; Poisson's was never seen to (Brach; Glocker, Pfeiffer, "Multiple impacts
// with friction in rigid multibody systems", 1995). That is checked, and e is lowered until there is no gain (e = 0
// never gains).
#pragma once

#include <vector>

#include "cone/solver.hpp"
#include "geometry/guard.hpp"
#include "step/integrator.hpp"

namespace contactvi {

// A pair with its points, or a joint limit, that is closed at an event.
struct ClosedGuard {
  int guard = -1;
  double e = 0, mu = 0;
  bool persistent = false;  // closed before the event
  bool impacted = false;    // an impulse of this event acted on it
  int count = 0;            // of points that have rows
  std::vector<ContactPoint> points;
  // Closed points that were not chosen: they have an impact only if the body tips about the others.
  std::vector<ContactPoint> unused;
  int chosen = 0;  // of points: the first ones, which span the contact
  Contact witness;
  std::vector<Contact> contacts;
  std::vector<Vec3> t1;
  int rows = 0;
  MatX W, MinvW;  // nv x rows at least; projected on the constraints
  MatX mu_fixed;  // impulses of the constraints per unit impulse of a row, (constraint rows, rows)
  VecX offset;    // part of the rows' velocities that moving constraints cause

  int rows_per_point() const { return mu > 0.0 ? 3 : 1; }
  // Normal speed of a point, negative on approach.
  double gamma_n(int point, const VecX& p) const { return speed(point * rows_per_point(), p); }
  double speed(int row, const VecX& p) const { return MinvW.col(row).dot(p) + offset[row]; }
  VecX speeds(const VecX& p) const { return MinvW.leftCols(rows).transpose() * p + offset.head(rows); }
  // Kinetic energy T- - T+ that impulses take, without the work of moving constraints [J].
  double loss(const VecX& lambda, const VecX& p_minus, const VecX& p_plus) const {
    return -0.5 * lambda.dot(speeds(p_minus) + speeds(p_plus));
  }
  // Least normal speed of all points.
  double gamma_n(const VecX& p) const;
};

struct BlockMember {
  ClosedGuard* closed;
  double e;
};

struct PoissonResult {
  bool ok = false;
  VecX lambda;  // impulses of all rows, member after member
  VecX first;   // those of the compression alone
  VecX gamma_minus, gamma_plus;
  double loss = 0;         // T- - T+ [J]
  double restitution = 1;  // factor on e that was used
  int iterations = 0;
};

class PoissonImpact {
 public:
  PoissonResult solve(const std::vector<BlockMember>& members, const VecX& p);

 private:
  bool cone(const VecX& start, bool expansion, double share, const std::vector<BlockMember>& members, VecX& lambda);

  ConeSolver solver_;
  std::vector<ConeContact> cones_;
  MatX G_;
  VecX first_;
  int iterations_ = 0;
};

}  // namespace contactvi

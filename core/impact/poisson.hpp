// Impacts with friction or with several points at once: Poisson's restitution as two cone problems.
//
//   compression  gamma_1 = gamma + G Lambda_1, e = 0 with Coulomb's law (maximal dissipation);
//   expansion    gamma+ = gamma_1 + G Lambda_2,  Lambda_2n >= e Lambda_1n, gamma+_n >= 0, complementary, Coulomb again.
// All points of a pair are one impact: a box that falls flat rises straight. Newton's e on the normal speed with
// Coulomb friction can gain energy; Poisson's was never seen to (Brach; Glocker, Pfeiffer, "Multiple impacts with
// friction in rigid multibody systems", 1995), and that is checked: where it would, e is lowered until it does not (e =
// 0 never gains).
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
  bool persistent = false;  // before the event
  bool hit = false;
  int count = 0;  // of points in use below
  std::vector<ContactPoint> points;
  // Closed ones that are not in use: they close only if the body tips about the others
  std::vector<ContactPoint> unused;
  int chosen = 0;  // of points: those that span the contact
  Contact witness;
  std::vector<Contact> contacts;
  std::vector<Vec3> t1;
  int rows = 0;
  MatX W, MinvW;  // nv x rows at least; projected on the constraints
  MatX mu_fixed;  // answers of the constraints, their rows x rows
  VecX offset;    // of the rows' velocities

  int rows_per_point() const { return mu > 0.0 ? 3 : 1; }
  // Normal speed of a point, of the most closing one.
  double gamma_n(int point, const VecX& p) const { return speed(point * rows_per_point(), p); }
  double speed(int row, const VecX& p) const { return MinvW.col(row).dot(p) + offset[row]; }
  VecX speeds(const VecX& p) const { return MinvW.leftCols(rows).transpose() * p + offset.head(rows); }
  // T- - T+ of impulses, less what moving constraints give.
  double loss(const VecX& lambda, const VecX& p_minus, const VecX& p_plus) const {
    return -0.5 * lambda.dot(speeds(p_minus) + speeds(p_plus));
  }
  double gamma_n(const VecX& p) const;
};

struct BlockMember {
  ClosedGuard* closed;
  double e;
};

struct BlockResult {
  bool ok = false;
  VecX lambda;  // impulses of all rows, member after member
  VecX gamma_minus, gamma_plus;
  double loss = 0;         // T- - T+ [J]
  double restitution = 1;  // share of e that was used
  int iterations = 0;
};

class PoissonImpact {
 public:
  BlockResult solve(const std::vector<BlockMember>& members, const VecX& p);

 private:
  bool cone(const VecX& start, bool expansion, double share, const std::vector<BlockMember>& members, VecX& lambda);

  ConeSolver solver_;
  std::vector<ConeContact> cones_;
  MatX G_;
  VecX first_;
  int iterations_ = 0;
};

}  // namespace contactvi

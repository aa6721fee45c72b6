// Impacts with friction or with several points at once: Poisson's restitution as two cone problems.
//
//   compression  gamma_1 = gamma + G Lambda_1, e = 0 with Coulomb's law (maximal dissipation);
//   expansion    gamma+ = gamma_1 + G Lambda_2,  Lambda_2n >= e Lambda_1n, gamma+_n >= 0, complementary, Coulomb again.
// All points of a pair are one impact, so that a box that falls flat rises without turning. Newton's e on the normal
// speed with Coulomb friction can gain energy; Poisson's was never seen to (Brach; Glocker, Pfeiffer, "Multiple impacts
// with friction in rigid multibody systems", 1995). That is checked, and e is lowered until there is no gain (e = 0
// never gains).
//
// A pair may have another law (model/contact_law.hpp):
//   Newton       one problem with gamma+_n + e gamma-_n >= 0 in the place of gamma+_n;
//   energetic    the least impulses of the expansion are k Lambda_1n, with the k by which normal impulses give back e^2
//                of the work that they took in the compression;
//   tangential   where friction holds, gamma+_t = -e_t gamma-_t: the expansion is then a problem for both impulses,
//                Lambda_n >= (1 + e) Lambda_1n, with gamma+_t + e_t gamma-_t in the place of gamma+_t.
// One point with the incremental or the energetic law is followed through its impact (incremental_impact.hpp).
#pragma once

#include <vector>

#include "cone/solver.hpp"
#include "geometry/guard.hpp"
#include "model/friction_state.hpp"
#include "step/integrator.hpp"

namespace contactvi {

// A pair with its points, or a joint limit, that is closed at an event.
struct ClosedGuard {
  int guard = -1;
  double e = 0, mu = 0, time = 0;    // [s] of the event
  const ContactLaw* law = nullptr;   // where its friction is not one number
  double spinning = 0, rolling = 0;  // radii of friction [m]
  bool persistent = false;           // closed before the event
  bool impacted = false;             // an impulse of this event acted on it
  int count = 0;                     // of points that have rows
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
  VecX offset;    // part of the rows' velocities that moving constraints and surfaces cause

  int rows_per_point() const { return mu > 0.0 ? 3 + (spinning > 0.0 ? 1 : 0) + (rolling > 0.0 ? 2 : 0) : 1; }
  // Normal speed of a point, negative on approach.
  double gamma_n(int point, const VecX& p) const { return speed(point * rows_per_point(), p); }
  double speed(int row, const VecX& p) const { return MinvW.col(row).dot(p) + offset[row]; }
  VecX speeds(const VecX& p) const { return MinvW.leftCols(rows).transpose() * p + offset.head(rows); }
  // Kinetic energy T- - T+ that impulses take, without the work of moving constraints [J].
  double loss(const VecX& lambda, const VecX& p_minus, const VecX& p_plus) const {
    return -0.5 * lambda.dot(speeds(p_minus) + speeds(p_plus));
  }
  // Friction of a point: that of its slip before the impact. An impact has no friction of rest.
  double friction(int point, const VecX& p) const {
    if (law == nullptr || (!law->mu.given() && law->mu_of_state == nullptr)) return mu;
    const double slip = std::hypot(speed(3 * point + 1, p) / law->shares[0], speed(3 * point + 2, p) / law->shares[1]);
    return law->mu.given() ? law->mu(slip) : impact_friction(*law, slip, time).mu;
  }
  // Least normal speed of all points.
  double gamma_n(const VecX& p) const;
};

struct BlockMember {
  ClosedGuard* closed;
  double e;
};

struct ImpactBlockResult {
  bool ok = false;
  VecX lambda;  // impulses of all rows, member after member
  VecX first;   // those of the compression alone
  VecX gamma_minus, gamma_plus;
  double loss = 0;         // T- - T+ [J]
  double restitution = 1;  // factor on e that was used
  double gain = 0;         // energy that e itself would make [J], of a law that makes some
  int iterations = 0;
};

class ImpactBlock {
 public:
  // law: of the first member, null: Poisson's. The other ones have e = 0.
  ImpactBlockResult solve(const std::vector<BlockMember>& members, const VecX& p, const ContactLaw* law = nullptr);
  // The problem of the last solve() with other numbers: speeds gamma-, G, e of the first member and friction of the
  // points. Restitution is not lowered.
  const ImpactBlockResult& solve_again(const VecX& gamma, const MatX& G, double e, const VecX& mu,
                                       const ContactLaw* law);
  // What each point did in the last problem: equal where a change of the numbers has changed no piece of the law.
  const std::vector<char>& course() const { return course_; }

 private:
  void set_problem(const std::vector<BlockMember>& members, const VecX& p);
  bool follow(double e, const ContactLaw& law);
  void note_course(const VecX& impulses, bool again);
  bool cone(const VecX& start, VecX& lambda);
  bool impulses(double e, double tangential, const ContactLaw& law);
  bool expand(double e, double tangential);
  bool expand_by_energy(double e, double tangential);
  double normal_work(const VecX& lambda, const VecX& before) const;
  void finish();

  ConeSolver solver_;
  std::vector<ConeContact> cones_;
  MatX G_;
  VecX first_, second_, speeds_;  // impulses of the two problems; speeds of the rows that a problem starts from
  ImpactBlockResult result_;
  int own_ = 0;              // points of the first member
  bool compressed_ = false;  // first_ is the compression
  std::vector<char> course_;
};

}  // namespace contactvi

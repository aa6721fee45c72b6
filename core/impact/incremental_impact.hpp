// One contact point followed through its impact: the slip turns, stops and turns back while the normal impulse grows.
//
//   d w / d Lambda_n = G (1, -mu d)      d = w_t / |w_t|      while it slips,
//
// and where the slip has stopped it sticks as long as friction within the cone can hold it, else it goes off in the one
// direction in which it leaves zero. The compression ends where w_n = 0. The impulse ends
//   Poisson     at (1 + e) times that of the compression,
//   Newton      at w_n = -e times that before the impact,
//   energetic   where the work of the normal impulse since the compression is e^2 times that of the compression.
// Routh, "Dynamics of a system of rigid bodies", 1905; Keller, "Impact with friction", 1986; Stronge, "Impact
// mechanics", 2000; Batlle, "The sliding velocity flow of rough collisions in multibody systems", 1996.
#pragma once

#include <vector>

#include "base/numerics.hpp"
#include "model/contact_law.hpp"

namespace contactvi {

struct IncrementalImpact {
  bool ok = false;
  Vec3 lambda = Vec3::Zero();       // impulse (n, t1, t2) [N s]
  Vec3 compression = Vec3::Zero();  // of it that until w_n = 0
  // What it did, one after the other: 1 the compression ended, 2 the slip stopped, 3 it then stuck, 4 it slid off.
  std::vector<char> course;
};

// G (3, 3): Delassus matrix, symmetric positive definite; w: velocity before the impact, w_n < 0 [m/s].
IncrementalImpact follow_impact(const Mat3& G, const Vec3& w, double mu, double e, RestitutionLaw law);

}  // namespace contactvi

// Stage B: semismooth Newton steps on the natural map of the whole law (block_law.hpp), with the velocities of the
// blocks as unknowns (Alart and Curnier, "A mixed formulation for frictional contact problems prone to Newton like
// solution methods", 1991; the projection in the coordinates in which the cone is its own dual, Acary and Brogliato,
// "Numerical methods for nonsmooth dynamical systems", 2008).
#pragma once

#include <vector>

#include "cone/block_factor.hpp"
#include "cone/block_system.hpp"

namespace contactvi {

class BlockNewton {
 public:
  // At most `steps` from best; the best point with impulses of the cone is in best on return, unless none was better.
  // Stops at the tolerance. Returns the factorizations used.
  int run(const BlockSystem& system, BlockFactor& factor, int steps, double tolerance, ConePoint& best);

 private:
  double step(const BlockSystem& system, BlockFactor& factor);
  void add_turning(const BlockSystem& system, std::size_t k);
  double merit(const BlockSystem& system, const ConePoint& point) const;

  std::vector<Mat3> K_;
  std::vector<CrossWeight> crosses_;
  std::vector<Vec3> change_;  // of the impulses
  VecX velocity_;             // change of the velocities
  ConePoint point_, trial_, projected_;
};

}  // namespace contactvi

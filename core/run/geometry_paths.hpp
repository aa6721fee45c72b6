// How each geometry is carried in an interval: straight lines from where it is at the start, one after the other, with
// bends where impacts turn it.
#pragma once

#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

class GeometryPaths {
 public:
  struct Bend {
    double part;  // of the interval, until it is there
    Vec3 at;      // from where it was at the start of the interval [m, world]
  };

  explicit GeometryPaths(std::size_t geometries);
  // straight: as of straight(); empty: nothing is known.
  void restart(const MatX& straight);
  void forget(int geometry);
  // No point of it was farther than `besides` [m] from where it would have been, had it been carried at constant speeds
  // from bend to bend and to `along` [m, world], from where it was at the start.
  void set(int geometry, const std::vector<Bend>& bends, const Vec3& along, double besides);
  // As this, of the next interval, if it meets nothing.
  void foretell(int geometry, const Vec3& along, double besides);
  bool foretold(int geometry) const { return foretold_[static_cast<std::size_t>(geometry)] != 0; }
  // By how much two of them approach each other at most [m]: what is apart in a direction (a unit vector from a to b)
  // meets only by moving against it, in no known direction (zero) by moving at all. Infinite where a path is not known.
  double approach(int a, int b, const Vec3& direction) const;
  // (4, geometries) along and besides; NaN: not known.
  const MatX& straight() const { return straight_; }

 private:
  Vec3 place(int geometry, double part) const;

  MatX straight_;
  std::vector<std::vector<Bend>> bends_;
  std::vector<char> foretold_;
};

}  // namespace contactvi

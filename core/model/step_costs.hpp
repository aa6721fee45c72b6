// What steps with contacts cost, by counts and sizes: the same on every machine, so that what is decided by it is, too.
//
// The numbers are microseconds, to a factor of two: fits to what such steps took in stacks, heaps and a hand on the
// machine of docs/benchmarks.md. Only their ratios matter.
#pragma once

#include <algorithm>

#include "model/tree.hpp"

namespace contactvi::costs {

inline double contact_iteration(double rows) { return 2.0 + 0.03 * rows * rows; }
inline double cone_iteration(double rows) { return 0.5 + 5e-4 * rows * rows * rows; }
inline double contact_step() { return 8.0; }   // besides its iterations: events, forces
inline double impact() { return 5.0; }         // besides its distances
inline double near_distance() { return 0.3; }  // in closed form, and to a ball
inline double distance() { return 2.0; }       // by coal
// A step with persistent contacts to which nothing happens.
inline double quiet_contact_step(double rows) {
  return contact_step() + 6.0 * contact_iteration(rows) + 20.0 * cone_iteration(rows);
}

// A dense step with so many points. Few are solved by sweeps; of many the contact problem is dear, up to some 30
// factorizations of a matrix with a block per tree.
class Dense {
 public:
  explicit Dense(const Tree& tree) {
    double size = 0.0, largest = 0.0;
    const auto close = [&] {
      cubes_ += size * size * size / 3.0;
      largest = std::max(largest, size);
      size = 0.0;
    };
    for (const Joint& joint : tree.joints) {
      if (joint.parent < 0) close();
      size += joint.nv;
    }
    close();
    per_point_ = 0.03 * 12.0 * largest * largest;
  }
  double step(double points) const {
    const double share = std::min(1.0, points / kMany);
    return 10.0 + 5.0 * points + share * (0.03 * cubes_ + (40.0 + per_point_) * points);
  }

 private:
  static constexpr double kMany = 20.0;
  double cubes_ = 0.0, per_point_ = 0.0;
};

}  // namespace contactvi::costs

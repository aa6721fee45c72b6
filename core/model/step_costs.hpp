// What steps with contacts cost, by counts and sizes: the same on every machine, so that what is decided by it is, too.
//
// The numbers are microseconds, to a factor of two: fits to what such steps took in stacks, heaps and a hand on the
// machine of docs/benchmarks.md. Only their ratios matter.
#pragma once

#include "model/tree.hpp"

namespace contactvi::costs {

inline double contact_iteration(double rows) { return 2.0 + 4e-3 * rows * rows; }
inline double cone_iteration(double rows) { return 0.5 + rows * rows * (0.01 + 7e-5 * rows); }
inline double contact_step() { return 8.0; }   // besides its iterations: events, forces
inline double impact() { return 5.0; }         // besides its distances
inline double near_distance() { return 0.3; }  // in closed form, and to a ball
inline double distance() { return 2.0; }       // by coal
// A step with persistent contacts to which nothing happens.
inline double quiet_contact_step(double rows) {
  return contact_step() + 1.5 * contact_iteration(rows) + 8.0 * cone_iteration(rows);
}

// A dense step with so many points, of the trees of one island.
class Dense {
 public:
  explicit Dense(const Tree& tree) {
    double size = 0.0;
    const auto close = [&] {
      cubes_ += size * size * size;
      size = 0.0;
    };
    for (const Joint& joint : tree.joints) {
      if (joint.parent < 0) close();
      size += joint.nv;
    }
    close();
  }
  double step(double points) const { return 5.0 + points * (4.0 + 0.05 * points) + 6e-3 * cubes_; }

 private:
  double cubes_ = 0.0;
};

}  // namespace contactvi::costs

// What steps with contacts cost, by counts and sizes: the same on every machine, so that what is decided by it is, too.
//
// The numbers are microseconds, to a factor of two: fits to what such steps took in stacks, heaps, a hand, quadrupeds
// and humanoids on the machine of docs/benchmarks.md. Only their ratios matter.
#pragma once

#include "model/tree.hpp"

namespace contactvi::costs {

inline double cone_iteration(double rows) { return 0.5 + rows * rows * (0.01 + 7e-5 * rows); }
inline double near_distance() { return 0.3; }  // in closed form, and to a ball
inline double distance() { return 2.0; }       // by coal

// Of steps of the trees of one island.
class Steps {
 public:
  explicit Steps(const Tree& tree) {
    double size = 0.0;
    const auto close = [&] {
      dofs_ += size;
      squares_ += size * size;
      size = 0.0;
    };
    for (const Joint& joint : tree.joints) {
      if (joint.parent < 0) close();
      size += joint.nv;
    }
    close();
  }
  // Of a smooth step, whole or to an event: all trees of the island are solved for, whatever they do.
  double stage_iteration() const { return 0.1 * dofs_ + 2e-3 * squares_; }
  double contact_iteration(double rows) const { return 2.0 + 4e-3 * rows * rows + 6e-3 * squares_; }
  // A step with persistent contacts besides its iterations: events, forces.
  double contact_step() const { return 8.0; }
  // One to which nothing happens.
  double quiet_contact_step(double rows) const {
    return contact_step() + 1.5 * contact_iteration(rows) + 8.0 * cone_iteration(rows);
  }
  double impact() const { return 5.0 + 1.2e-2 * squares_; }  // besides its distances
  double dense_step(double points) const {
    // A tree is reduced to what its contacts reach where it is larger than a free body.
    return 5.0 + points * (4.0 + 0.05 * points) + 0.2 * dofs_ + 0.12 * (squares_ - kFreeBody * dofs_);
  }

 private:
  static constexpr double kFreeBody = 6.0;
  double dofs_ = 0.0, squares_ = 0.0;
};

}  // namespace contactvi::costs

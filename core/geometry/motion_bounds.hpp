// How far everything can move while the velocities stay within a bound: points of geometries, joint limits, rotations
// of bodies. So may velocities that are not known, or accelerations, be bounded.
#pragma once

#include <utility>
#include <vector>

#include "model/scene.hpp"

namespace contactvi {

class MotionBounds {
 public:
  explicit MotionBounds(const Scene& scene);

  // Per geometry any of its points [m], in the world and then in the frames of bodies that it hangs on, which is what
  // counts for pairs of one robot; per joint limit [m; rad]; per body its rotation [rad].
  struct Reach {
    std::vector<double> geometry, limit, turn;
  };
  Reach none() const;
  // Of a geometry and frame together; the first ones are those of the geometries in the world.
  std::size_t entries() const { return scene_->geometries.size() + ways_.size(); }
  // Bounds the lengths of the chains of bodies from q on, shape (nq,), for velocities within bound, shape (nv,), over
  // so many steps of length h.
  void bound_arms(const VecCRef& q, const VecX& bound, double h, double steps);
  // What those velocities do over one step, within the arms bounded before.
  void propagate(const VecX& bound, double h, Reach& reach);
  // Of the two bodies of a guard together; both: of numbers per entry.
  double of(const Reach& reach, int guard) const;
  double turn_of(const Reach& reach, int guard) const;
  double both(const std::vector<double>& values, int guard) const {
    return values[pair_ways_[guard].first] + values[pair_ways_[guard].second];
  }
  // The last body that moves both shapes of a pair, -1: none.
  int base(int pair) const { return bases_[pair]; }
  // Between two points of the shape of a pair that is bounded, at most [m].
  double longest_arm(int pair) const;

 private:
  void find_ways();

  const Scene* scene_;
  std::vector<double> linear_;   // per body: bound on its origin's displacement
  std::vector<double> own_arm_;  // per body: bound on the distance of its origin from its parent's
  std::vector<double> arm_;      // per body: the lengths of its chain from the world
  struct Way {
    int geometry, base;  // in the frame of this body
  };
  std::vector<Way> ways_;                       // of pairs of one tree
  std::vector<std::pair<int, int>> pair_ways_;  // of each pair: the entries of its shapes
  std::vector<int> bases_;
};

}  // namespace contactvi

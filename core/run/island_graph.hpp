// Which static trees may meet in the next interval: the edges by which trees become islands.
//
// Every geometry has a ball that contains it while it has moved less than the ball's margin; pairs of balls that
// overlap are neighbours, and only neighbours are looked at. A pair whose distance was d stays certified until the two
// geometries together have moved by d, as in geometry/guard.hpp.
#pragma once

#include <vector>

#include "base/disjoint_sets.hpp"
#include "geometry/guard.hpp"
#include "model/static_trees.hpp"

namespace contactvi {

class IslandGraph {
 public:
  // Distances are those of `guards`, whose scene is the whole one, without persistent contacts.
  IslandGraph(const StaticTrees& trees, Guards& guards);

  // Forgets where everything is; motion: bound on the motion of each geometry in the next interval [m].
  void restart(const std::vector<double>& motion);
  // Joins trees that may meet in the next interval from q.
  void join_suspects(const VecX& q, double slack, DisjointSets& sets);
  // Sets how far a geometry has moved at most in the interval under way [m].
  void set_motion(int geometry, double distance) {
    motion_[geometry] = distance;
    const double part = distance * inverse_[geometry];
    if (!(part <= largest_)) largest_ = part;
  }
  // Joins trees of different sets that may have met in the interval under way from q.
  void join_met(const VecX& q, DisjointSets& sets);
  // The interval is over.
  void commit();
  // Of the last interval, per geometry: all that the next search depends on.
  const std::vector<double>& motion() const { return motion_; }

 private:
  struct Neighbour {
    int geometry, guard;
    double mark;  // sum of the two odometers up to which the pair is certified; kept by the smaller of the two
  };
  void place(const VecX& q);
  void renew(int g, double margin);
  int guard_of(int a, int b) const;
  double clearance(const Neighbour& n, int g);
  void find_room(DisjointSets& sets);
  bool may_meet(int g, Neighbour& n, double reach);

  const StaticTrees* trees_;
  Guards* guards_;
  const Scene* scene_;
  std::vector<int> movable_;  // geometries with pairs between trees
  struct Partner {
    int geometry, guard;
  };
  std::vector<std::vector<Partner>> partners_;  // of each geometry, in other trees; sorted
  std::vector<char> sphere_;
  std::vector<double> radius_, reach_, motion_, odometer_, limit_;
  std::vector<double> x_, y_, z_, ball_;  // the balls of movable_; ball_: radius with margin
  std::vector<int> slot_;                 // of a geometry in movable_
  std::vector<std::vector<Neighbour>> neighbours_;
  bool placed_ = false;
  // A reference interval moves each geometry by the reach that it had when room_ was found; inverse_ is one over that.
  // An interval counts as the least multiple of it that no geometry exceeds: largest_ is the one under way, last_ the
  // one before, used_ the sum since room_ was found. While that stays below room_, no ball has to be renewed and no
  // neighbours meet.
  std::vector<double> inverse_;  // [1/m]
  double room_ = 0.0, used_ = 0.0, largest_ = 0.0, last_ = 0.0;
  bool clear_ = false;  // the interval under way was found to be clear
};

}  // namespace contactvi

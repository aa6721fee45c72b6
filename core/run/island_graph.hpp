// Which static trees may meet in the next interval: the edges by which trees become islands.
//
// Every geometry has a ball that contains it while it has moved less than the ball's margin; pairs of balls that
// overlap are neighbours, and only neighbours are looked at. A pair whose distance was d stays certified until the two
// geometries together have moved by d, as in geometry/guard.hpp.
#pragma once

#include <utility>
#include <vector>

#include "base/disjoint_sets.hpp"
#include "geometry/guard.hpp"
#include "model/static_trees.hpp"
#include "run/geometry_paths.hpp"

namespace contactvi {

class IslandGraph {
 public:
  // Distances are those of `guards`, whose scene is the whole one, without persistent contacts.
  IslandGraph(const StaticTrees& trees, Guards& guards);

  // Forgets where everything is, and takes all for active; motion, straight: of each geometry in the next interval, as
  // of set_motion and GeometryPaths; empty: none is known.
  void restart(const std::vector<double>& motion, const MatX& straight);
  // From now on only these geometries move, until other ones are named. Of the others the odometer is to be right and
  // the motion zero.
  void set_active(std::vector<int> geometries);
  // The next interval is not found to be clear.
  void end_clear() { room_ = 0.0; }
  // The trees that the last search has joined.
  const std::vector<std::pair<int, int>>& joins() const { return joins_; }
  void forget_joins() { joins_.clear(); }
  // An interval begins: whether nobody can meet in it, whatever moved in the last one.
  bool find_clear();
  bool clear() const { return clear_; }
  // Whether nobody can have met in an interval that was found to be clear.
  bool stays_clear() const { return clear_ && used_ + largest_ < room_; }
  // Joins trees that may meet in the next interval from q, where it is not clear. How far each geometry has moved has
  // to be known.
  void join_suspects(const VecX& q, double slack, DisjointSets& sets);
  // Sets how far a geometry has moved at most in the interval under way, or in the last one [m].
  void set_motion(int geometry, double distance) {
    motion_[geometry] = distance;
    paths_.forget(geometry);
    count(part(geometry, distance));
  }
  // After that: how it was carried in that interval, or will be in the next one.
  GeometryPaths& paths() { return paths_; }
  const GeometryPaths& paths() const { return paths_; }
  // And until the start of that interval.
  void set_place(int geometry, double odometer) { odometer_[geometry] = odometer; }
  double odometer(int geometry) const { return odometer_[geometry]; }
  // The interval under way counts as at least so many reference intervals.
  void count(double intervals) {
    if (!(intervals <= largest_)) largest_ = intervals;
  }
  // The part of a reference interval in which a geometry moves so far [m].
  double part(int geometry, double distance) const { return distance * inverse_[geometry]; }
  // A reference interval is another one whenever this number is.
  long room_number() const { return rooms_; }
  // Joins trees of different sets that may have met in the interval under way from q, where it did not stay clear. How
  // far each geometry has moved has to be known.
  void join_met(const VecX& q, DisjointSets& sets);
  // The interval is over.
  void commit();
  // Of intervals that count as so many reference intervals each: how many of the first ones will be found to be clear
  // and stay so. pass() makes that many of them, at least one, at the end of which no motion is told.
  int foresee(const std::vector<double>& counts) const;
  void pass(const std::vector<double>& counts, int intervals);
  // Whether motion() is that of the last interval, and odometer() that at its end. know_motion(): after set_place() and
  // set_motion() for all, between two intervals.
  bool knows_motion() const { return knows_motion_; }
  void know_motion();
  // Whether how far each geometry moves in the interval under way is told; measure(): it is after all.
  bool measured() const { return measured_; }
  void measure() { measured_ = true; }
  // Of the last interval, per geometry: all that the next search depends on.
  const std::vector<double>& motion() const { return motion_; }

 private:
  static constexpr double kReach = 1.5;  // of the motion in the last interval: that expected in the next one
  struct Neighbour {
    int geometry, guard;
    double mark;  // sum of the two odometers up to which the pair is certified, as the one that looks at it knows
  };
  void place(const VecX& q);
  void renew(int g, double margin);
  int guard_of(int a, int b) const;
  // A lower bound on the distance of two neighbours, and a direction [unit vector] from the first to the second in
  // which they are so far apart; zero where none is known.
  struct Apart {
    double distance;
    Vec3 direction;
  };
  Apart clearance(const Neighbour& n, int g, double reach);
  Apart exact_distance(const Neighbour& n, int g);
  void find_room(DisjointSets& sets);
  double approach(int g, const Neighbour& n, const Vec3& direction) const;
  // What a pair may approach by, of how far its geometries move together [m] and of approach().
  struct Moves {
    double together, share;
  };
  bool may_meet(int g, Neighbour& n, const Moves& moves);
  // Each pair of which one moves is looked at from one side: the moving one, of two the first.
  bool looks_at(int g, const Neighbour& n) const { return n.geometry > g || !is_active_[n.geometry]; }
  void join(int g, const Neighbour& n, DisjointSets& sets);
  bool is_clear(double used, double last) const { return used + kReach * last + 1.0 < room_; }

  const StaticTrees* trees_;
  Guards* guards_;
  const Scene* scene_;
  std::vector<int> movable_;  // geometries with pairs between trees
  std::vector<int> active_;   // those that move, ascending
  std::vector<char> is_active_;
  std::vector<std::pair<int, int>> joins_;
  struct Partner {
    int geometry, guard;
  };
  std::vector<std::vector<Partner>> partners_;  // of each geometry, in other trees; sorted
  std::vector<char> sphere_;
  std::vector<double> radius_, reach_, motion_, odometer_, limit_;
  std::vector<double> x_, y_, z_, ball_;  // the balls of movable_; ball_: radius with margin
  std::vector<int> slot_;                 // of a geometry in movable_
  std::vector<std::vector<Neighbour>> neighbours_;
  std::vector<Neighbour> before_;  // workspace of renew: the neighbours so far
  GeometryPaths paths_;
  std::vector<double> intervals_;  // for how many of them the margin of a ball is
  // Neighbours that could have met by how far each moves, but not by how far they move against each other, if this
  // stays below their distance at the start of the interval under way.
  struct Approaching {
    int geometry;
    Neighbour neighbour;
    Apart apart;
  };
  std::vector<Approaching> approaching_;
  bool placed_ = false;
  // A reference interval moves each geometry by the reach that it had when room_ was found; inverse_ is one over that.
  // An interval counts as the least multiple of it that no geometry exceeds: largest_ is the one under way, last_ the
  // one before, used_ the sum since room_ was found. While that stays below room_, no ball has to be renewed and no
  // neighbours meet.
  std::vector<double> inverse_;  // [1/m]
  double room_ = 0.0, used_ = 0.0, largest_ = 0.0, last_ = 0.0;
  bool clear_ = false;      // the interval under way was found to be clear
  bool was_clear_ = false;  // and the one before
  bool measured_ = false;   // motion_ is, or will be, that of the interval under way
  bool knows_motion_ = false;
  long rooms_ = 0;  // how often room_ was found
};

}  // namespace contactvi

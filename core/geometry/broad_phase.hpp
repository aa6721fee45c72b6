// Broad phase: the pairs of shapes that are near enough to touch in a step.
//
// Each geometry has a fat box: its bounding box, fattened by its motion of several steps. A bound on the way of its
// points, the odometer, tells until when it stays in there. Pairs whose fat boxes are apart are far, and a step does
// not look at them; the list of the near ones changes only where a geometry may leave its fat box and gets a new one.
//
// What a far pair keeps: whatever the step does within its motion bound, both shapes stay in their fat boxes, and so
// they would for as long a way again. The gap of a far pair therefore is larger at the end of the step than the motion
// of the two in it, which is what makes the event search pass over an exact gap as well.
#pragma once

#include <memory>
#include <vector>

#include "geometry/box.hpp"
#include "geometry/pair_table.hpp"

namespace contactvi {

class BroadPhase {
 public:
  struct NearPair {
    int guard, a, b;  // a, b: geometries
  };

  explicit BroadPhase(const Scene& scene);
  ~BroadPhase();

  // Forgets all boxes: the bodies have been put elsewhere.
  void invalidate();
  // Whether some geometry may leave its fat box in a step that moves its points by at most motion[geometry]; then renew
  // has to be called. early: or has used up half of its box. odometer: per geometry, at the start of the step.
  bool is_outdated(const std::vector<double>& odometer, const std::vector<double>& motion, bool early);
  // The geometries that is_outdated has found, and those that have used up half of their boxes.
  const std::vector<int>& leaving() const { return leaving_; }
  // Gives them new boxes about their places at the end of the step, where their bodies have been placed.
  void renew(const Placements& at, const std::vector<double>& odometer, const std::vector<double>& motion);
  // What the odometer of a geometry may come to before its box has to be renewed [m].
  double limit(int geometry) const { return limits_[geometry]; }
  // Ascending by guard.
  const std::vector<NearPair>& near_pairs() const { return near_; }

  struct Memory {
    std::vector<Box> boxes;
    std::vector<double> limits;
    std::vector<NearPair> near;
  };
  Memory memory() const { return {boxes_, limits_, near_}; }
  void recall(const Memory& memory);

 private:
  void look_at_all(const Placements& at);
  void find_partners(int geometry, const Placements& at);
  bool may_meet(int geometry, int plane, const Placements& at) const;
  void add_near(int a, int b);

  const Scene* scene_;
  bool few_;  // whether the pairs are few, and looked at without the tree
  std::shared_ptr<const PairTable> pairs_;
  std::vector<int> planes_;     // the halfspaces
  std::vector<Box> boxes_;      // per geometry: its fat box
  std::vector<double> limits_;  // per geometry: what its odometer may come to
  std::vector<NearPair> near_;
  std::vector<NearPair> added_, merged_;  // workspace of renew
  std::vector<int> leaving_;
  std::vector<char> is_leaving_;  // per geometry
  struct BoxTree;                 // coal's, kept out of this header
  std::unique_ptr<BoxTree> tree_;
};

}  // namespace contactvi

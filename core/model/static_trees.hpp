// Static trees: children of the world with all that hangs on them, joined for good where a constraint or a spring
// couples them. A scene restricted to some of them is a scene of its own.
#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "model/scene.hpp"

namespace contactvi {

// Trees are numbered by their first joint.
class StaticTrees {
 public:
  explicit StaticTrees(const Scene& scene);

  int count() const { return static_cast<int>(joints_.size()); }
  const std::vector<int>& joints(int tree) const { return joints_[tree]; }
  int of_joint(int joint) const { return joint < 0 ? -1 : of_joint_[joint]; }
  int of_geometry(int geometry) const { return of_geometry_[geometry]; }
  const std::vector<int>& geometries(int tree) const { return geometries_[tree]; }
  // The trees of the two sides of a guard, -1: the world or none.
  std::pair<int, int> of_guard(const Scene& scene, int guard) const;

  // Pairs of a tree with itself and with the world, by number; and those with geometries of other trees.
  const std::vector<int>& own_pairs(int tree) const { return own_pairs_[tree]; }
  struct CrossPair {
    int tree, pair;  // the other tree
  };
  const std::vector<CrossPair>& cross_pairs(int tree) const { return cross_pairs_[tree]; }

 private:
  std::vector<int> of_joint_, of_geometry_;
  std::vector<std::vector<int>> joints_, geometries_, own_pairs_;
  std::vector<std::vector<CrossPair>> cross_pairs_;
};

// A scene restricted to a set of static trees and the geometries that are fixed to the world. Its numbers follow the
// order of those of the whole; the lists tell for each of them that of the whole.
struct SubScene {
  Scene scene;
  std::vector<int> joints, q, v, geometries, guards, constraint_rows, friction;  // friction: of Elements::friction_dofs
  std::vector<int> reactions;  // constraint rows, and after those of the whole its followers
};

// trees: sorted.
std::unique_ptr<SubScene> restrict_scene(const Scene& whole, const StaticTrees& trees, const std::vector<int>& chosen);
// The numbers of the whole scene itself; its `scene` stays empty.
std::unique_ptr<SubScene> whole_scene_numbers(const Scene& whole);

}  // namespace contactvi

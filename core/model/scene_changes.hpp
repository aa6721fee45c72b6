// Numbers of a scene that differ from run to run: a copy of the scene takes those of a run.
//
// The numbers of a run stand in one row. A copy has the bits of a scene that was built with these numbers, as long as
// they do not change which springs, servos and dampers the scene has besides those of single joints.
#pragma once

#include <vector>

#include "model/scene.hpp"

namespace contactvi {

// What a number of a row is, and what the index of its place counts.
enum class SceneNumber : int {
  kGravity,           // coordinate
  kRestitution,       // pair
  kFriction,          // pair
  kLimitRestitution,  // joint of Pinocchio's model
  kStiffness,         // joint of Pinocchio's model
  kRest,              // number of q
  kArmature,          // degree of freedom
  kDamping,           // degree of freedom
  kKp,                // degree of freedom
  kKd,                // degree of freedom
  // Joint of Pinocchio's model. The number is the first of ten: mass, centre of mass, rotational inertia about it (xx
  // xy xz yy yz zz), in the frame of that joint.
  kBody,
};

class SceneChanges {
 public:
  // Throws Error where the scene has no such number.
  void add(const Scene& scene, SceneNumber kind, int index, int column);
  // Least length of a row.
  int columns() const { return columns_; }
  // Sets the numbers of a row in a copy of the scene that `add` was given.
  void apply(const VecX& row, Scene& scene) const;

 private:
  struct Place {
    SceneNumber kind;
    int index, column;
  };
  std::vector<Place> places_;
  int columns_ = 0;
};

}  // namespace contactvi

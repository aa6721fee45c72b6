#include "model/scene_changes.hpp"

#include <algorithm>

#include "base/error.hpp"

namespace contactvi {

namespace {

constexpr int kBodyNumbers = 10;

int count_of(const Scene& scene, SceneNumber kind) {
  switch (kind) {
    case SceneNumber::kGravity:
      return 3;
    case SceneNumber::kRestitution:
    case SceneNumber::kFriction:
      return static_cast<int>(scene.pairs.size());
    case SceneNumber::kLimitRestitution:
    case SceneNumber::kStiffness:
    case SceneNumber::kBody:
      return static_cast<int>(scene.tree.body_of_source.size());
    case SceneNumber::kRest:
      return scene.tree.nq;
    case SceneNumber::kArmature:
    case SceneNumber::kDamping:
      return scene.tree.nv;
    case SceneNumber::kKp:
      return static_cast<int>(scene.tree.elements.servo_kp.size());
    case SceneNumber::kKd:
      return static_cast<int>(scene.tree.elements.servo_kd.size());
  }
  return 0;
}

void set_limit_restitution(Tree& tree, int source, double value) {
  for (JointLimit& limit : tree.limits)
    if (limit.source_joint == source) limit.restitution = value;
}

// The springs of a joint, linear and not, have one rest.
void set_rest(Tree& tree, int number, double value) {
  tree.rest[number] = value;
  for (JointPotential& potential : tree.elements.joint_potentials)
    if (tree.joints[potential.joint].iq == number) potential.rest = value;
}

void set_body_numbers(Tree& tree, int source, const double* own) {
  Mat3 about_com;
  about_com << own[4], own[5], own[6], own[5], own[7], own[8], own[6], own[8], own[9];
  const Mat3 turn = tree.R_body_source[source].transpose();
  set_body(tree.joints[tree.body_of_source[source]], own[0], Vec3(own[1], own[2], own[3]), about_com, turn);
}

}  // namespace

void SceneChanges::add(const Scene& scene, SceneNumber kind, int index, int column) {
  const bool of_joint = kind == SceneNumber::kBody || kind == SceneNumber::kStiffness;
  if (column < 0 || index < 0 || index >= count_of(scene, kind) || (of_joint && scene.tree.body_of_source[index] < 0))
    throw Error("the scene has no such number");
  places_.push_back({kind, index, column});
  columns_ = std::max(columns_, column + (kind == SceneNumber::kBody ? kBodyNumbers : 1));
}

void SceneChanges::apply(const VecX& row, Scene& scene) const {
  Tree& tree = scene.tree;
  for (const Place& place : places_) {
    const double value = row[place.column];
    const int i = place.index;
    switch (place.kind) {
      case SceneNumber::kGravity:
        tree.gravity[i] = value;
        break;
      case SceneNumber::kRestitution:
        scene.pairs[i].restitution = value;
        break;
      case SceneNumber::kFriction:
        scene.pairs[i].friction = value;
        break;
      case SceneNumber::kLimitRestitution:
        set_limit_restitution(tree, i, value);
        break;
      case SceneNumber::kStiffness:
        tree.joints[tree.body_of_source[i]].stiffness = value;
        break;
      case SceneNumber::kRest:
        set_rest(tree, i, value);
        break;
      case SceneNumber::kArmature:
        tree.armature[i] = value + (tree.lent_armature.size() > 0 ? tree.lent_armature[i] : 0.0);
        break;
      case SceneNumber::kDamping:
        tree.damping[i] = value;
        break;
      case SceneNumber::kKp:
        tree.elements.servo_kp[i] = value;
        break;
      case SceneNumber::kKd:
        tree.elements.servo_kd[i] = value;
        break;
      case SceneNumber::kBody:
        set_body_numbers(tree, i, row.data() + place.column);
        break;
    }
  }
  find_springs_and_damping(tree);
}

}  // namespace contactvi

#include "geometry/motion_bounds.hpp"

#include <algorithm>
#include <cmath>
#include <map>

namespace contactvi {

namespace {
constexpr double kMotionRounding = 1e-14;  // of the motion in the world: what its parts are added up to
}  // namespace

MotionBounds::MotionBounds(const Scene& scene)
    : scene_(&scene),
      linear_(scene.tree.joints.size()),
      own_arm_(scene.tree.joints.size()),
      arm_(scene.tree.joints.size()) {
  find_ways();
}

MotionBounds::Reach MotionBounds::none() const {
  return {std::vector<double>(entries()), std::vector<double>(scene_->tree.limits.size()),
          std::vector<double>(scene_->tree.joints.size())};
}

// What moves both bodies of a pair does not change its distance: its motion counts in the frame of the last body that
// both hang on.
void MotionBounds::find_ways() {
  const int count = static_cast<int>(scene_->geometries.size());
  std::map<std::pair<int, int>, int> known;
  const auto way = [&](int geometry, int base) {
    if (base < 0) return geometry;
    const auto [at, is_new] = known.emplace(std::pair(geometry, base), count + static_cast<int>(ways_.size()));
    if (is_new) ways_.push_back({geometry, base});
    return at->second;
  };
  for (const Pair& pair : scene_->pairs) {
    int a = scene_->geometries[pair.a].body, b = scene_->geometries[pair.b].body;
    while (a != b) {
      int& later = a > b ? a : b;  // a parent has a lower number
      later = scene_->tree.joints[later].parent;
    }
    pair_ways_.emplace_back(way(pair.a, a), way(pair.b, a));
    bases_.push_back(a);
  }
}

// The joints that prismatic ones and the like lengthen, over so many steps like this one.
void MotionBounds::bound_arms(const VecCRef& q, const VecX& bound, double h, double steps) {
  const Tree& tree = scene_->tree;
  for (std::size_t i = 0; i < tree.joints.size(); ++i) {
    const Joint& joint = tree.joints[i];
    double& arm = own_arm_[i];
    arm = joint.p_PJ.norm();
    if (joint.type == JointType::kPrismatic) arm += std::abs(q[joint.iq]) + steps * h * bound[joint.iv];
    if (joint.type == JointType::kHelical)
      arm += std::abs(joint.pitch) * (std::abs(q[joint.iq]) + steps * h * bound[joint.iv]);
    if (joint.type == JointType::kTranslation)
      arm += q.segment<3>(joint.iq).norm() + steps * h * bound.segment<3>(joint.iv).norm();
  }
}

// Over one step, within the arms bounded before.
void MotionBounds::propagate(const VecX& bound, double h, Reach& reach) {
  const Tree& tree = scene_->tree;
  for (std::size_t k = 0; k < tree.limits.size(); ++k) reach.limit[k] = h * bound[tree.joints[tree.limits[k].joint].iv];
  if (scene_->geometries.empty()) return;
  for (std::size_t i = 0; i < tree.joints.size(); ++i) {
    const Joint& joint = tree.joints[i];
    double angular = 0, linear = 0, arm = own_arm_[i];
    const double path = h * bound[joint.iv];
    switch (joint.type) {
      case JointType::kRevolute:
      case JointType::kContinuous:
      case JointType::kSpherical:
        angular = path;
        break;
      case JointType::kPrismatic:
        linear = path;
        break;
      case JointType::kHelical:
        angular = path;
        linear = std::abs(joint.pitch) * path;
        break;
      case JointType::kTranslation:
        linear = h * bound.segment<3>(joint.iv).norm();
        break;
    }
    if (joint.parent >= 0) {
      linear += linear_[joint.parent] + reach.turn[joint.parent] * arm;
      angular += reach.turn[joint.parent];
      arm += arm_[joint.parent];
    }
    reach.turn[i] = angular;
    linear_[i] = linear;
    arm_[i] = arm;
  }
  const std::size_t count = scene_->geometries.size();
  for (std::size_t g = 0; g < count; ++g) {
    const Geometry& geometry = scene_->geometries[g];
    const int body = geometry.body;
    reach.geometry[g] = body < 0 ? 0.0 : linear_[body] + reach.turn[body] * geometry.reach;
  }
  // Without the turns of what moves the base: they have moved the body by themselves times the arms beyond it.
  for (std::size_t k = 0; k < ways_.size(); ++k) {
    const Geometry& geometry = scene_->geometries[ways_[k].geometry];
    const int body = geometry.body, base = ways_[k].base;
    const double linear = linear_[body] - linear_[base] - reach.turn[base] * (arm_[body] - arm_[base]);
    reach.geometry[count + k] = std::max(0.0, linear) + (reach.turn[body] - reach.turn[base]) * geometry.reach +
                                (body == base ? 0.0 : kMotionRounding * reach.geometry[ways_[k].geometry]);
  }
}

double MotionBounds::of(const Reach& reach, int guard) const {
  if (!scene_->is_pair(guard)) return reach.limit[guard - static_cast<int>(scene_->pairs.size())];
  return both(reach.geometry, guard);
}

double MotionBounds::turn_of(const Reach& reach, int guard) const {
  if (!scene_->is_pair(guard)) return 0.0;
  const Pair& pair = scene_->pairs[guard];
  const auto turn = [&reach](int body) { return body < 0 ? 0.0 : reach.turn[body]; };
  return turn(scene_->geometries[pair.a].body) + turn(scene_->geometries[pair.b].body) - 2.0 * turn(bases_[guard]);
}

double MotionBounds::longest_arm(int guard) const {
  const Pair& pair = scene_->pairs[guard];
  return 2.0 * (scene_->geometries[pair.a].unbounded ? scene_->geometries[pair.b] : scene_->geometries[pair.a]).radius;
}

}  // namespace contactvi

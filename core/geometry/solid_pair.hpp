// A pair of two solids, or of a solid and a halfspace, as it is placed: their common normals.
#pragma once

#include "base/numerics.hpp"
#include "geometry/surface_frame.hpp"
#include "model/common_normals.hpp"
#include "model/scene.hpp"

namespace contactvi {

class SolidPair {
 public:
  // Whether the surfaces of both shapes of a pair are level sets, or that of one is and the other one is a halfspace.
  static bool is_one(const Scene& scene, int pair);

  SolidPair(const Scene& scene, int pair, const Placements& at);

  const CommonNormals& normals() const { return normals_; }
  // Which shape is the second one, on which places are looked for: b, unless that is a halfspace.
  bool second_is_b() const { return second_is_b_; }
  // The common normal near places that are fixed to the bodies.
  CommonNormal known(const Vec3& first_B, const Vec3& second_B) const {
    return {kNaN, Vec3::UnitZ(), in_surface(*first_, first_B), in_surface(*second_, second_B), false};
  }
  const Geometry& first() const { return *first_; }
  const Geometry& second() const { return *second_; }
  const Pose& first_pose() const { return first_pose_; }
  const Pose& second_pose() const { return second_pose_; }

 private:
  bool second_is_b_;
  const Geometry *first_, *second_;
  Pose first_pose_, second_pose_;  // of the surfaces, in the world
  CommonNormals normals_;
};

}  // namespace contactvi

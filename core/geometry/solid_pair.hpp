// A pair of two solids, or of a solid and a halfspace, as it is placed: their common normals.
#pragma once

#include "geometry/contact_features.hpp"
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
  int first_body() const { return first_->body; }
  int second_body() const { return second_->body; }
  bool first_is_solid() const { return first_->solid != nullptr; }
  // From the frame of the first or second surface to that of its body, and back.
  static Vec3 in_body(const Geometry& g, const Vec3& x) { return g.p_BG + g.R_BG * x; }
  static Vec3 in_surface(const Geometry& g, const Vec3& x_B) { return g.R_BG.transpose() * (x_B - g.p_BG); }
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

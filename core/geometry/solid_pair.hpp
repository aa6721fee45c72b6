// A pair that touches at common normals, as it is placed: two solids, a solid and a halfspace or a height field, and a
// cylinder and a solid or a height field.
#pragma once

#include <optional>
#include <variant>
#include <vector>

#include "base/numerics.hpp"
#include "geometry/contact_surface.hpp"
#include "geometry/surface_frame.hpp"
#include "model/common_normals.hpp"
#include "model/cylinder_normals.hpp"
#include "model/scene.hpp"

namespace contactvi {

class SolidPair {
 public:
  // Whether a pair is one of these.
  static bool is_one(const Scene& scene, int pair);

  SolidPair(const Scene& scene, int pair, const Placements& at);

  // See CommonNormals and CylinderNormals.
  void all(const std::vector<CommonNormal>& known, double reach, std::vector<CommonNormal>& found,
           std::vector<int>& number) const;
  bool near(const CommonNormal& known, CommonNormal& found) const;
  double depth(const CommonNormal& c) const;
  bool across(const CommonNormal& c, CommonNormal& found) const;
  // Whether the second shape reaches beyond the top of a height field. How far they are from each other at least, as
  // seen along the axes of the field; not a number, of which the scene has been told, where the border lies in it.
  bool beside(CommonNormal& c) const;
  // The surfaces of the first and the second shape at a common normal, in the world. False: they are not known.
  bool surfaces(const CommonNormal& at, ContactSurface (&found)[2]) const;

  // Which shape is the second one, on which places are looked for: a cylinder, or a solid, b of two.
  bool second_is_b() const { return second_is_b_; }
  // The common normal near places that are fixed to the bodies.
  CommonNormal known(const Vec3& first_B, const Vec3& second_B, int part) const {
    return {kNaN, Vec3::UnitZ(), in_surface(*first_, first_B), in_surface(*second_, second_B), false, part};
  }
  const Geometry& first() const { return *first_; }
  const Geometry& second() const { return *second_; }
  const Pose& first_pose() const { return first_pose_; }
  const Pose& second_pose() const { return second_pose_; }
  // Of a cell, across, of the second shape or the pair [m].
  double size() const;

 private:
  bool second_is_b_ = true;
  const Geometry *first_, *second_;
  Pose first_pose_, second_pose_;  // of the surfaces, in the world
  std::variant<std::monostate, CommonNormals, CylinderNormals> normals_;
};

}  // namespace contactvi

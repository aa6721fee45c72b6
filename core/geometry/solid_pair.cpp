#include "geometry/solid_pair.hpp"

#include <coal/shape/geometric_shapes.h>

#include <algorithm>
#include <cmath>

#include "model/height_field.hpp"
#include "model/implicit_surface.hpp"

namespace contactvi {

namespace {

// [m] Overlaps with the border of a height field that are less are rounding, or ripples of its surface.
constexpr double kOverBorder = 1e-6;

bool is_halfspace(const Geometry& g) { return g.unbounded && !g.surface; }
bool has_cylinder_shape(const Geometry& g) { return g.sharp->getNodeType() == coal::GEOM_CYLINDER; }

const SearchedSurface* searched(const Geometry& g) {
  if (g.field) return g.field.get();
  return g.solid.get();
}

Cylinder cylinder_of(const Geometry& g) {
  const auto& shape = static_cast<const coal::Cylinder&>(*g.sharp);
  return {shape.radius, shape.halfLength};
}

}  // namespace

bool SolidPair::is_one(const Scene& scene, int pair) {
  const Geometry &a = scene.geometries[scene.pairs[pair].a], &b = scene.geometries[scene.pairs[pair].b];
  for (const auto& [one, other] : {std::pair(&a, &b), std::pair(&b, &a)}) {
    if (one->field) return has_cylinder_shape(*other) || (other->solid && !other->field);
    if (one->surface && one->solid)
      return other->solid || has_cylinder_shape(*other) || is_halfspace(*other) || other->field;
  }
  return false;
}

SolidPair::SolidPair(const Scene& scene, int pair, const Placements& at) {
  const Geometry &a = scene.geometries[scene.pairs[pair].a], &b = scene.geometries[scene.pairs[pair].b];
  second_is_b_ = has_cylinder_shape(b) || (!has_cylinder_shape(a) && b.solid);
  first_ = second_is_b_ ? &a : &b;
  second_ = second_is_b_ ? &b : &a;
  first_pose_ = pose_of_surface(*first_, at);
  second_pose_ = pose_of_surface(*second_, at);
  const Mat3 R = first_pose_.R.transpose() * second_pose_.R;
  const Vec3 t = first_pose_.into(second_pose_.p);
  if (has_cylinder_shape(*second_)) {
    normals_ = CylinderNormals(*searched(*first_), cylinder_of(*second_), R, t);
  } else {
    const FirstSurface first{searched(*first_), first_->halfspace_normal, first_->halfspace_offset};
    normals_ = CommonNormals(first, *second_->solid, R, t);
  }
}

void SolidPair::all(const std::vector<CommonNormal>& known, double reach, std::vector<CommonNormal>& found,
                    std::vector<int>& number) const {
  if (const auto* cylinder = std::get_if<CylinderNormals>(&normals_))
    cylinder->all(known, reach, found, number);
  else
    std::get<CommonNormals>(normals_).all(known, reach, found, number);
}

bool SolidPair::near(const CommonNormal& known, CommonNormal& found) const {
  if (const auto* cylinder = std::get_if<CylinderNormals>(&normals_)) return cylinder->near(known, found);
  return std::get<CommonNormals>(normals_).near(known, found);
}

double SolidPair::depth(const CommonNormal& c) const {
  const auto* cylinder = std::get_if<CylinderNormals>(&normals_);
  return cylinder != nullptr ? cylinder->depth(c) : kInfinity;
}

bool SolidPair::across(const CommonNormal& c, CommonNormal& found) const {
  const auto* cylinder = std::get_if<CylinderNormals>(&normals_);
  return cylinder != nullptr && cylinder_part::is_rim(c.part) && cylinder->across(c, found);
}

double SolidPair::size() const {
  if (const auto* cylinder = std::get_if<CylinderNormals>(&normals_)) return cylinder->size();
  return second_->solid->size();
}

bool SolidPair::surfaces(const CommonNormal& at, ContactSurface (&found)[2]) const {
  const Mat3& R = first_pose_.R;
  CommonNormal c = at;
  if (!near(at, c)) return false;
  const Vec3 x = second_pose_.point(c.second), outward = -(R * c.normal);
  Mat3 bends[2];
  if (const auto* cylinder = std::get_if<CylinderNormals>(&normals_)) {
    if (!cylinder->bend(c, bends[0])) return false;
    const Cylinder& shape = cylinder->cylinder();
    const Vec3 axis = second_pose_.R.col(2), on_axis = second_pose_.point({0.0, 0.0, c.second[2]});
    if (c.part == cylinder_part::kLateral)
      found[1] = ContactSurface::line("side of a cylinder", on_axis, axis, shape.radius);
    else if (cylinder_part::is_end(c.part))
      found[1] = ContactSurface::plane("end of a cylinder", x, outward, 0.0);
    else if (cylinder_part::is_rim(c.part))
      found[1] = ContactSurface::rim(on_axis, axis, shape.radius, outward, 0.0);
    else
      found[1] = ContactSurface::point("point of a rim", x, 0.0);
  } else {
    if (!std::get<CommonNormals>(normals_).bends(c, bends[0], bends[1])) return false;
    found[1] = ContactSurface::curved("surface of a solid", x, R * bends[1] * R.transpose());
  }
  found[0] = ContactSurface::curved("surface of a solid", first_pose_.point(c.first), R * bends[0] * R.transpose());
  return true;
}

bool SolidPair::beside(CommonNormal& c) const {
  if (!first_->field) return false;
  const HeightField& field = *first_->field;
  const auto* cylinder = std::get_if<CylinderNormals>(&normals_);
  const Vec3 center = first_pose_.into(second_pose_.point(in_surface(*second_, second_->center_B)));
  if (!center.allFinite()) return false;
  Vec3 half = Vec3::Constant(second_->radius);
  if (cylinder != nullptr) {
    const Cylinder& shape = cylinder->cylinder();
    const Vec3 axis = first_pose_.R.transpose() * second_pose_.R.col(2);
    for (int k = 0; k < 3; ++k)
      half[k] = shape.half * std::abs(axis[k]) + shape.radius * std::sqrt(std::max(0.0, 1.0 - axis[k] * axis[k]));
  }
  // Beyond the rectangle, or above all of the block, by which distance and in which direction.
  Vec3 apart = Vec3::Zero();
  bool crosses = false;
  for (int k = 0; k < 2; ++k) {
    crosses |= center[k] - half[k] < field.low()[k] || center[k] + half[k] > field.high()[k];
    apart[k] =
        std::max(0.0, center[k] - half[k] - field.high()[k]) - std::max(0.0, field.low()[k] - center[k] - half[k]);
  }
  apart[2] = std::max(0.0, center[2] - half[2] - field.highest());
  if (!crosses) return false;
  double least = kInfinity;
  Vec3 place = Vec3::Zero();
  bool overlaps = false;
  for (const Vec3& x : field.border()) {
    const double away = ((x - center).cwiseAbs() - half).cwiseMax(0.0).norm();
    if (away < least) place = x;
    least = std::min(least, away);
    if (away > 0.0) continue;
    const Vec3 below = x - kOverBorder * Vec3::UnitZ();
    overlaps |= cylinder != nullptr ? cylinder->inside(below) > kOverBorder
                                    : second_->solid->is_inside(second_pose_.into(first_pose_.point(below)));
  }
  if (overlaps) {
    c.gap = kNaN;
    field.lose(place);
    return true;
  }
  const double distance = apart.norm();
  c = {distance, distance > 0.0 ? Vec3(apart / distance) : Vec3(Vec3::UnitZ()), center - apart, center, false};
  return true;
}

}  // namespace contactvi

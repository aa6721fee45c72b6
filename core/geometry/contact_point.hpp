// A point at which the two shapes of a pair touch, or the limit of a joint (manifold.hpp).
#pragma once

#include <cstdint>

#include "base/numerics.hpp"

namespace contactvi {

enum class PointKind : std::uint8_t { kWitness, kVertex, kRim, kLimit, kEdge, kEnd, kRimLine, kSurface, kSolids };

// Whether where the point is found again is kept with it (far_B).
inline bool moves_over_both(PointKind kind) {
  return kind == PointKind::kRim || kind == PointKind::kRimLine || kind == PointKind::kSurface ||
         kind == PointKind::kSolids;
}

struct ContactPoint {
  int guard;
  PointKind kind;
  // Identity within the guard, the same from step to step; 0: witness or limit. See Feature.
  std::int64_t feature;
  // The point is fixed to a sharp body: its slip is a displacement. Else it moves over both bodies: a velocity.
  bool material;
  // kVertex: a sphere of radius `radius` about a point of point_body against a plane of plane_body. Vectors of the
  // point are in point_body's frame (center_B, axis_B, far_B), those of the plane in plane_body's; -1: world.
  bool on_b;  // the point belongs to geometry b and the plane to a, else the other way round
  int point_body, plane_body;
  Vec3 center_B;
  double radius;
  Vec3 normal_B;  // outward: gap = normal.center - offset - radius
  double offset;
  // kRim: the circle of radius rim_radius about center_B, unit axis axis_B, swept by `radius`, against the plane.
  Vec3 axis_B;
  double rim_radius;
  Vec3 far_B;  // the circle's point farthest from the plane when the point was found
  // kEdge: the line of b through center_B along axis_B, swept by `radius`, against the line of a through origin_B along
  // normal_B, swept by `offset`. Directed so that normal_B x axis_B points from a to b; on_b is true.
  // kEnd: the point center_B of point_body, swept by `radius`, against the line of plane_body through origin_B along
  // normal_B, swept by `offset`. kRimLine: the circle of kRim against such a line, where they are nearest near far_B.
  // kSurface: the point center_B, swept by `radius`, against a surface that a function gives; of several feet the one
  // near far_B, in plane_body's frame.
  // kSolids: the common normal of two shapes, one of them a solid or a height field, near the place center_B on the
  // surface of point_body and the place origin_B on that of plane_body.
  Vec3 origin_B;
};

// Whether these are one point, perhaps at two instants.
inline bool same_point(const ContactPoint& a, const ContactPoint& b) {
  return a.guard == b.guard && a.kind == b.kind && a.feature == b.feature;
}

}  // namespace contactvi

// Regions of the features of a core: the points outside of it that are nearest to one face, edge or vertex, to one rim,
// the side or an end of a cylinder, to the side or a tip of a capsule (Voronoi regions).
//
// The gap to a ball is smooth while the centre of the ball stays in one region. Where it passes to the next one the
// second derivative of the gap jumps, and so does the acceleration of a ball that rolls there.
#pragma once

#include <cstdint>

#include "geometry/shape_features.hpp"

namespace contactvi {

class NearestRegion {
 public:
  // No region: all points outside of the core are in it.
  NearestRegion() = default;
  // False for shapes of one feature: balls, halfspaces, ellipsoids.
  static bool has_regions(const ShapeFeatures& shape) {
    return !shape.ellipsoid && !shape.is_unbounded() && !shape.edges.empty();
  }
  // That of the point x outside of the core of a shape with regions, in its frame; no region where x lies inside.
  static NearestRegion of(const ShapeFeatures& shape, const Vec3& x);

  bool any() const { return kind_ != Kind::kAll; }
  // How far x is from its nearest border [m], negative outside; infinite without borders.
  double depth(const Vec3& x) const;

 private:
  enum class Kind : std::uint8_t { kAll, kFace, kEdge, kVertex, kSide, kTip, kEnd, kRim };

  double beside_face(int face, const Vec3& x) const;

  const ShapeFeatures* shape_ = nullptr;
  Kind kind_ = Kind::kAll;
  int number_ = -1;  // of the face, edge, vertex, tip or rim
};

}  // namespace contactvi

#include "geometry/nearest_region.hpp"

#include <algorithm>
#include <limits>

#include "geometry/core_projection.hpp"

namespace contactvi {

NearestRegion NearestRegion::of(const ShapeFeatures& shape, const Vec3& x) {
  NearestRegion found;
  found.shape_ = &shape;
  if (!shape.rims.empty()) {
    const ShapeFeatures::Edge& axis = shape.edges[0];
    const double s = (x - axis.start).dot(axis.direction);
    const Vec3 end = s < 0.0 ? axis.start : Vec3(axis.start + axis.length * axis.direction);
    const bool beside = (x - axis.start - s * axis.direction).norm() > shape.rims[0].radius;
    if (s >= 0.0 && s <= axis.length) {
      if (beside) found.kind_ = Kind::kSide;
      return found;
    }
    found.kind_ = beside ? Kind::kRim : Kind::kEnd;
    const auto to_rim = [&](int rim) { return (shape.rims[static_cast<std::size_t>(rim)].center - end).squaredNorm(); };
    found.number_ = to_rim(0) <= to_rim(1) ? 0 : 1;
    return found;
  }
  if (shape.faces.empty()) {  // a capsule
    const ShapeFeatures::Edge& axis = shape.edges[0];
    const double s = (x - axis.start).dot(axis.direction);
    found.kind_ = s < 0.0 || s > axis.length ? Kind::kTip : Kind::kSide;
    found.number_ = s < 0.0 ? 0 : 1;
    return found;
  }
  Vec3 middle = Vec3::Zero();
  for (const Vec3& vertex : shape.vertices) middle += vertex / static_cast<double>(shape.vertices.size());
  CoreProjection core(shape, x - middle);
  Vec3 y;
  Mat3 change;
  if (!core.project(x, y, change)) return found;
  const CoreProjection::Place at = core.place();
  found.kind_ = at.vertex >= 0 ? Kind::kVertex : at.edge >= 0 ? Kind::kEdge : Kind::kFace;
  found.number_ = at.vertex >= 0 ? at.vertex : at.edge >= 0 ? at.edge : at.face;
  return found;
}

// How far x lies beside an edge of a face, away from the face.
double NearestRegion::beside_face(int face, const Vec3& x) const {
  if (face < 0) return std::numeric_limits<double>::infinity();
  const ShapeFeatures::Face& f = shape_->faces[static_cast<std::size_t>(face)];
  for (int k = f.first; k < f.first + f.count; ++k)
    if (shape_->ring_edge[k] == number_) return shape_->side[k].dot(x) - shape_->side_offset[k];
  return std::numeric_limits<double>::infinity();
}

double NearestRegion::depth(const Vec3& x) const {
  if (!any()) return std::numeric_limits<double>::infinity();
  const ShapeFeatures& o = *shape_;
  const auto along = [&x](const ShapeFeatures::Edge& e) { return (x - e.start).dot(e.direction); };
  const auto number = static_cast<std::size_t>(number_);
  switch (kind_) {
    case Kind::kAll:
      break;
    case Kind::kFace:
      return -outside_of(o, o.faces[number], x);
    case Kind::kEdge: {
      const ShapeFeatures::Edge& e = o.edges[number];
      const double s = along(e);
      return std::min({s, e.length - s, beside_face(e.left, x), beside_face(e.right, x)});
    }
    case Kind::kVertex: {
      double least = std::numeric_limits<double>::infinity();
      for (int i : o.vertex_edges[number]) {
        const ShapeFeatures::Edge& e = o.edges[static_cast<std::size_t>(i)];
        least = std::min(least, e.v0 == number_ ? -along(e) : along(e) - e.length);
      }
      return least;
    }
    case Kind::kSide:
    case Kind::kTip: {
      const double s = along(o.edges[0]), beyond = s - o.edges[0].length;
      return kind_ == Kind::kSide ? std::min(s, -beyond) : number_ == 0 ? -s : beyond;
    }
    case Kind::kEnd:
    case Kind::kRim: {
      const ShapeFeatures::Rim& rim = o.rims[number];
      const Vec3 d = x - rim.center;
      const double above = d.dot(rim.axis), beside = (d - above * rim.axis).norm() - rim.radius;
      return kind_ == Kind::kEnd ? -beside : std::min(above, beside);
    }
  }
  return std::numeric_limits<double>::infinity();
}

}  // namespace contactvi

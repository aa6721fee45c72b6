#include "geometry/contact_features.hpp"

#include <algorithm>

#include "model/cylinder_normals.hpp"

namespace contactvi {

namespace {

// How far n lies outside of the arc of normals of an edge [rad], both in one frame and n orthogonal to the edge.
double outside_arc(const ShapeFeatures& o, const ShapeFeatures::Edge& e, const Vec3& n) {
  if (e.left < 0 || e.right < 0) return -1.0;
  const Vec3 &l = o.faces[e.left].normal, &r = o.faces[e.right].normal;
  if (n.dot(l + r) < 0.0) return 1.0;
  return -std::min(l.cross(n).dot(e.direction), n.cross(r).dot(e.direction));
}

}  // namespace

int feature_rim(std::int64_t n) {
  switch (feature_kind(n)) {
    case Feature::kRimA:
    case Feature::kRimB:
    case Feature::kRimSideA:
    case Feature::kRimSideB:
      return feature_i(n);
    case Feature::kRimPointA:
    case Feature::kRimPointB:
      return feature_i(n) / kRimPoints;
    case Feature::kSolidsA:
    case Feature::kSolidsB:
      return cylinder_part::rim_of(feature_i(n));
    default:
      return -1;
  }
}

Pose pose_of(int body, const Placements& at) {
  if (body < 0) return {Mat3::Identity(), Vec3::Zero()};
  return {at.R_W[body], at.p_W[body]};
}

Line line_of(const ShapeFeatures& o, const Pose& pose, int edge) {
  const ShapeFeatures::Edge& e = o.edges[edge];
  return {pose.point(e.start), pose.R * e.direction, e.length, o.radius + e.radius};
}

double outside_cone(const PairView& v, int edge_a, int edge_b, const Vec3& normal_W) {
  return std::max(outside_arc(*v.a, v.a->edges[edge_a], v.pose_a.R.transpose() * normal_W),
                  outside_arc(*v.b, v.b->edges[edge_b], -(v.pose_b.R.transpose() * normal_W)));
}

}  // namespace contactvi

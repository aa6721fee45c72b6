#include "geometry/other_features.hpp"

#include <algorithm>

namespace contactvi {

namespace {

bool is_polytope(const ShapeFeatures& shape) {
  return shape.vertices.size() > 1 && shape.rims.empty() && !shape.is_unbounded() && !shape.ellipsoid;
}

bool are_edges(const ContactPoint& point) {
  return point.kind == PointKind::kEdge && feature_kind(point.feature) == Feature::kEdges;
}

bool is_vertex(const ContactPoint& point) {
  const Feature kind = feature_kind(point.feature);
  return point.kind == PointKind::kVertex && (kind == Feature::kVertexA || kind == Feature::kVertexB);
}

// From a to b, world frame, of the length of the sine.
Vec3 product_of_edges(const PairView& v, const ContactPoint& point) {
  return (v.pose_a.R * point.normal_B).cross(v.pose_b.R * point.axis_B);
}

// What touches of a shape: a line, or a place, of which `along` is zero.
struct Hinge {
  Vec3 place, along;
  double distance(const Vec3& x) const {
    const Vec3 d = x - place;
    return (d - d.dot(along) * along).norm();
  }
};

// Whether all vertices of a shape lie behind the plane through a hinge, across its outward unit normal m; those that
// touch need not.
template <class Touches>
bool all_behind(const ShapeFeatures& shape, const Vec3& m, const Hinge& hinge, const Behind& by,
                const Touches& touches) {
  const double height = m.dot(hinge.place) + by.slack;
  bool behind = true;
  const auto look_at = [&](int i) {
    const Vec3& x = shape.vertices[i];
    if (behind && m.dot(x) - height + by.per_distance * hinge.distance(x) >= 0.0) behind = touches(i);
  };
  if (shape.tree.none())
    for (int i = 0; behind && i < static_cast<int>(shape.vertices.size()); ++i) look_at(i);
  else
    shape.tree.each(
        m,
        [&](const VertexTree::Bound& bound) {
          const double distance = hinge.distance(bound.center) + bound.radius;
          return behind && bound.reach(m) - height + by.per_distance * distance >= 0.0;
        },
        look_at);
  return behind;
}

// Of an edge that touches at some place; m: outward.
bool rest_behind(const ShapeFeatures& shape, const ShapeFeatures::Edge& edge, const Vec3& m, const Behind& by) {
  return all_behind(shape, m, {edge.start, edge.direction}, by, [&](int i) { return i == edge.v0 || i == edge.v1; });
}

}  // namespace

double crossing_of(const PairView& v, const ContactPoint* const* points, int count) {
  if (count == 0 || !is_polytope(*v.a) || !is_polytope(*v.b)) return 0.0;
  const ContactPoint& first = *points[0];
  if (count == 1 && are_edges(first)) return product_of_edges(v, first).norm();
  const bool one_face = std::all_of(points, points + count, [&](const ContactPoint* point) {
    return is_vertex(*point) && point->on_b == first.on_b && feature_j(point->feature) == feature_j(first.feature);
  });
  return one_face ? 1.0 : 0.0;
}

bool others_behind(const PairView& v, const ContactPoint* const* points, int count, const Behind& by) {
  const ContactPoint& first = *points[0];
  if (are_edges(first)) {
    const Vec3 n = product_of_edges(v, first).normalized();
    return rest_behind(*v.a, v.a->edges[feature_i(first.feature)], v.pose_a.R.transpose() * n, by) &&
           rest_behind(*v.b, v.b->edges[feature_j(first.feature)], v.pose_b.R.transpose() * -n, by);
  }
  // The shape with the face is behind its plane wherever it is.
  const ShapeFeatures& over = first.on_b ? *v.b : *v.a;
  const Mat3 &R_over = first.on_b ? v.pose_b.R : v.pose_a.R, &R_under = first.on_b ? v.pose_a.R : v.pose_b.R;
  const Vec3 m = R_over.transpose() * (R_under * -first.normal_B);
  return all_behind(over, m, {over.vertices[feature_i(first.feature)], Vec3::Zero()}, by, [&](int i) {
    return std::any_of(points, points + count, [&](const ContactPoint* p) { return feature_i(p->feature) == i; });
  });
}

}  // namespace contactvi

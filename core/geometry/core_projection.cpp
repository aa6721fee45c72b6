#include "geometry/core_projection.hpp"

#include <algorithm>
#include <limits>

namespace contactvi {

namespace {

// Spacings of doubles: the rounding of points of the size of a polytope, and of the direction from one to another,
// which is that over their distance.
constexpr double kCoreRounding = 8.0 * std::numeric_limits<double>::epsilon();

}  // namespace

CoreProjection::CoreProjection(const ShapeFeatures& shape, const Vec3& outward) : shape_(&shape) {
  if (shape.faces.empty() || !shape.rims.empty()) return;
  int vertex = 0;
  for (int i = 1; i < static_cast<int>(shape.vertices.size()); ++i)
    if (outward.dot(shape.vertices[i]) > outward.dot(shape.vertices[vertex])) vertex = i;
  for (int f : shape.vertex_faces[vertex])
    if (face_ < 0 || shape.faces[f].normal.dot(outward) > shape.faces[face_].normal.dot(outward)) face_ = f;
}

bool CoreProjection::project(const Vec3& x, Vec3& y, Mat3& change) {
  if (!shape_->rims.empty()) return on_cylinder(x, y, change);
  if (!shape_->faces.empty()) return on_polytope(x, y, change);
  if (!shape_->edges.empty()) return on_segment(x, y, change);
  y = shape_->vertices[0];
  change.setZero();
  return true;
}

bool CoreProjection::is_nearest(const Vec3& x, const Vec3& y) const {
  const double distance = (x - y).norm();
  const Vec3 m = (x - y) / distance;
  double size = 0.0, beyond = 0.0;
  for (const Vec3& v : shape_->vertices) {
    size = std::max(size, v.cwiseAbs().maxCoeff());
    beyond = std::max(beyond, m.dot(v - y));
  }
  return shape_->faces.empty() || !shape_->rims.empty() || beyond <= kCoreRounding * size * (1.0 + size / distance);
}

bool CoreProjection::on_segment(const Vec3& x, Vec3& y, Mat3& change) const {
  const ShapeFeatures::Edge& e = shape_->edges[0];
  const double s = (x - e.start).dot(e.direction), inside = std::clamp(s, 0.0, e.length);
  y = e.start + inside * e.direction;
  change.setZero();
  if (s == inside) change = e.direction * e.direction.transpose();
  return true;
}

bool CoreProjection::on_cylinder(const Vec3& x, Vec3& y, Mat3& change) const {
  const ShapeFeatures::Edge& axis = shape_->edges[0];
  const Vec3& u = axis.direction;
  const double s = (x - axis.start).dot(u), inside = std::clamp(s, 0.0, axis.length);
  const Vec3 across = x - axis.start - s * u;
  const double away = across.norm(), radius = shape_->rims[0].radius;
  if (!(away > radius)) {
    y = x + (inside - s) * u;
    change = Mat3::Identity() - u * u.transpose();
    return s != inside;
  }
  y = axis.start + inside * u + (radius / away) * across;
  const Vec3 around = u.cross(across) / away;
  change = (radius / away) * around * around.transpose();
  if (s == inside) change += u * u.transpose();
  return true;
}

double CoreProjection::height(int face, const Vec3& x) const {
  const ShapeFeatures::Face& f = shape_->faces[face];
  return f.normal.dot(x) - f.offset;
}

// Sees to it that x lies above the plane of face_.
bool CoreProjection::find_visible(const Vec3& x) {
  if (height(face_, x) > 0.0) return true;
  for (int f = 0; f < static_cast<int>(shape_->faces.size()); ++f)
    if (height(f, x) > height(face_, x)) face_ = f;
  return height(face_, x) > 0.0;
}

CoreProjection::Spot CoreProjection::spot(int face, const Vec3& x) const {
  const ShapeFeatures::Face& f = shape_->faces[face];
  const double above = height(face, x);
  Spot found{above * above, x - above * f.normal, face};
  if (outside_of(*shape_, f, found.y) <= 0.0) return found;
  found.square = INFINITY;
  for (int k = f.first; k < f.first + f.count; ++k) {
    const ShapeFeatures::Edge& e = shape_->edges[shape_->ring_edge[k]];
    const double s = (x - e.start).dot(e.direction);
    const int vertex = s <= 0.0 ? e.v0 : s >= e.length ? e.v1 : -1;
    const Vec3 y = vertex >= 0 ? shape_->vertices[vertex] : Vec3(e.start + s * e.direction);
    const double square = (x - y).squaredNorm();
    if (square < found.square) found = {square, y, face, vertex < 0 ? shape_->ring_edge[k] : -1, vertex};
  }
  return found;
}

void CoreProjection::try_face(int face, const Vec3& x, Spot& best) const {
  if (face < 0 || face == best.face || !(height(face, x) > 0.0)) return;
  const Spot other = spot(face, x);
  if (other.square < best.square) best = other;
}

// Walks over the faces that x sees, each time to one that has the nearest point so far on its border, as long as the
// distance falls. Where no such face is nearer, x - y is a normal of the polytope at y, and so y is nearest of all.
bool CoreProjection::on_polytope(const Vec3& x, Vec3& y, Mat3& change) {
  if (!find_visible(x)) return false;
  Spot best = spot(face_, x);
  for (int last = -1; last != best.face;) {
    last = best.face;
    const Spot from = best;
    if (from.edge >= 0)
      for (int f : {shape_->edges[from.edge].left, shape_->edges[from.edge].right}) try_face(f, x, best);
    if (from.vertex >= 0)
      for (int f : shape_->vertex_faces[from.vertex]) try_face(f, x, best);
  }
  face_ = best.face;
  place_ = {best.face, best.edge, best.vertex};
  y = best.y;
  if (best.vertex >= 0) {
    change.setZero();
  } else if (best.edge >= 0) {
    const Vec3& u = shape_->edges[best.edge].direction;
    change = u * u.transpose();
  } else {
    const Vec3& n = shape_->faces[face_].normal;
    change = Mat3::Identity() - n * n.transpose();
  }
  return true;
}

}  // namespace contactvi

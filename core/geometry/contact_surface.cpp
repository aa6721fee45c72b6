#include "geometry/contact_surface.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "geometry/contact.hpp"

namespace contactvi {

namespace {

// [m] A point that is this near to the border of a feature may belong to the next one: nearest points are found up to
// kBorder beyond a border, and the factor keeps what was found clear of it.
constexpr double kMeetingBorder = 2.0 * kBorder;
// [rad] A normal that is this near to the border of the normals of a feature may belong to the next one, and one that
// is no farther from the normals of a flat feature belongs to it. Normals are differences of points, with a rounding of
// 1e-16 m, over the distance of two cores, which are 2e-6 m apart and more: 1e-10 rad, and another factor of 100.
constexpr double kSameNormal = 1e-8;
// [m] The same for points of coal, which iterates: with an error of the distance of 1e-10 m the place is wrong by the
// root of that times a radius of curvature.
constexpr double kNearby = 1e-5;

double distance_from_line(const ShapeFeatures::Edge& e, const Vec3& x) {
  const Vec3 d = x - e.start;
  return (d - d.dot(e.direction) * e.direction).norm();
}

}  // namespace

ContactSurface ContactSurface::point(const char* name, const Vec3& x, double sweep) {
  ContactSurface s;
  s.kind_ = Kind::kPoint;
  s.name_ = name;
  s.x_ = x;
  s.sweep_ = sweep;
  return s;
}

ContactSurface ContactSurface::line(const char* name, const Vec3& x, const Vec3& u, double sweep) {
  ContactSurface s = point(name, x, sweep);
  s.kind_ = Kind::kLine;
  s.axis_ = u;
  return s;
}

ContactSurface ContactSurface::plane(const char* name, const Vec3& x, const Vec3& n, double sweep) {
  ContactSurface s = point(name, x, sweep);
  s.kind_ = Kind::kPlane;
  s.axis_ = n;
  return s;
}

ContactSurface ContactSurface::rim(const Vec3& center, const Vec3& axis, double radius, const Vec3& outward,
                                   double sweep) {
  ContactSurface s = point("rim", center, sweep);
  s.kind_ = Kind::kRim;
  s.center_ = center;
  s.axis_ = axis;
  s.radius_ = radius;
  s.move(Vec3::Zero(), outward);
  return s;
}

ContactSurface ContactSurface::curved(const char* name, const Vec3& x, const Mat3& B) {
  ContactSurface s = point(name, x, 0.0);
  s.kind_ = Kind::kCurved;
  s.turning_ = B;
  return s;
}

namespace {

// Eigenvalues of a symmetric map of the plane of e[0] and n x e[0]; e[0] becomes the direction of the first one.
Eigen::Vector2d principal(const Mat3& map, const Vec3& n, Vec3& e) {
  const Vec3 t[2] = {e, n.cross(e)};
  Eigen::Matrix2d R;
  for (int i = 0; i < 2; ++i)
    for (int j = 0; j < 2; ++j) R(i, j) = t[i].dot(map * t[j]);
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(R);
  e = eigen.eigenvectors()(0, 0) * t[0] + eigen.eigenvectors()(1, 0) * t[1];
  return eigen.eigenvalues();
}

}  // namespace

ContactSurface ContactSurface::ellipsoid(const Ellipsoid& ellipsoid, const Vec3& outward, double sweep) {
  ContactSurface s = point("ellipsoid", ellipsoid.center, sweep);
  s.kind_ = Kind::kEllipsoid;
  s.ellipsoid_ = ellipsoid;
  s.move(Vec3::Zero(), outward);
  return s;
}

Bend ContactSurface::bend(const Vec3& n) const {
  Bend b{};
  b.e[0] = any_tangent(n);
  switch (kind_) {
    case Kind::kPoint:
      break;
    case Kind::kLine:
      b.e[0] = (axis_ - axis_.dot(n) * n).normalized();
      b.flat[0] = true;
      break;
    case Kind::kPlane:
      b.flat[0] = b.flat[1] = true;
      break;
    case Kind::kRim: {
      const Vec3 along = axis_.cross(n);
      const double sine = along.norm();
      b.e[0] = along / sine;
      b.radius[0] = radius_ / sine;
      break;
    }
    case Kind::kEllipsoid: {
      const Eigen::Vector2d radii = principal(ellipsoid_.bend(n), n, b.e[0]);
      b.radius[0] = radii[0];
      b.radius[1] = radii[1];
      break;
    }
    case Kind::kCurved: {
      const Eigen::Vector2d curvatures = principal(turning_, n, b.e[0]);
      b.flat[0] = b.flat[1] = true;
      b.curvature[0] = curvatures[0];
      b.curvature[1] = curvatures[1];
      break;
    }
  }
  b.e[1] = n.cross(b.e[0]);
  return b;
}

double ContactSurface::missing_turn(const Vec3& outward, const Vec3& e) const {
  return kind_ == Kind::kPlane ? axis_.dot(e) : -axis_.dot(outward) / axis_.dot(e);
}

void ContactSurface::move(const Vec3& s, const Vec3& outward) {
  switch (kind_) {
    case Kind::kPoint:
      break;
    case Kind::kLine:
      x_ += axis_.dot(s) * axis_;
      break;
    case Kind::kPlane:
      x_ += s - axis_.dot(s) * axis_;
      break;
    case Kind::kRim: {
      const Vec3 across = outward - axis_.dot(outward) * axis_;
      x_ = center_ + radius_ * across.normalized();
      break;
    }
    case Kind::kEllipsoid:
      x_ = ellipsoid_.point(outward);
      break;
    case Kind::kCurved:  // its foot is found where it is taken
      break;
  }
}

ContactSurface ContactSurface::of(const ShapeFeatures& o, const Pose& pose, int number, const Vec3& x, const Vec3& m) {
  ContactSurface found;
  const auto on = [&](const ShapeFeatures::Edge& e) {
    return pose.point(e.start + (x - e.start).dot(e.direction) * e.direction);
  };
  const bool polytope = !o.faces.empty();
  const int first_edge = static_cast<int>(o.vertices.size()),
            first_face = first_edge + static_cast<int>(o.edges.size());
  if (!o.rims.empty()) {
    const ShapeFeatures::Edge& axis = o.edges[0];
    const ShapeFeatures::Rim& rim = o.rims[number % 2 == 1 ? 0 : 1];
    if (number == 0)
      found = line("side of a cylinder", on(axis), pose.R * axis.direction, axis.radius + o.radius);
    else if (number <= 2)
      found = plane("end of a cylinder", pose.point(x + (rim.center - x).dot(rim.axis) * rim.axis), pose.R * rim.axis,
                    o.radius);
    else
      found = ContactSurface::rim(pose.point(rim.center), pose.R * rim.axis, rim.radius, pose.R * m, o.radius);
  } else if (number < first_edge) {
    const char* name = polytope ? "vertex" : o.vertices.size() == 2 ? "end of a capsule" : "ball";
    found = point(name, pose.point(o.vertices[number]), o.radius);
  } else if (number < first_face) {
    const ShapeFeatures::Edge& e = o.edges[number - first_edge];
    found = line(polytope ? "edge" : "side of a capsule", on(e), pose.R * e.direction, o.radius);
  } else {
    const ShapeFeatures::Face& f = o.faces[number - first_face];
    const double above = f.normal.dot(x) - f.offset;
    found = plane("face", pose.point(x - above * f.normal), pose.R * f.normal, o.radius);
  }
  found.number_ = number;
  return found;
}

const char* ContactSurface::find_on_polytope(const ShapeFeatures& o, const Pose& pose, const Vec3& x, const Vec3& m,
                                             bool nearby, ContactSurface& found) {
  const double near = nearby ? kNearby : kMeetingBorder;
  const bool polytope = !o.faces.empty();
  int vertex = 0;
  for (int i = 1; i < static_cast<int>(o.vertices.size()); ++i)
    if ((o.vertices[i] - x).squaredNorm() < (o.vertices[vertex] - x).squaredNorm()) vertex = i;
  if ((o.vertices[vertex] - x).norm() <= near) {
    found = of(o, pose, vertex, x, m);
    double most = -1.0;  // sine of the angle by which the normal is outside of those of the vertex
    for (int i : o.vertex_edges[vertex]) {
      const ShapeFeatures::Edge& e = o.edges[i];
      most = std::max(most, e.v0 == vertex ? e.direction.dot(m) : -e.direction.dot(m));
    }
    if (nearby || most < -kSameNormal) return nullptr;
    return polytope ? "a vertex and an edge" : "the end and the side of a capsule";
  }
  const int first_edge = static_cast<int>(o.vertices.size()),
            first_face = first_edge + static_cast<int>(o.edges.size());
  int edge = -1;
  double least = near;
  for (int i = 0; i < static_cast<int>(o.edges.size()); ++i) {
    const double along = (x - o.edges[i].start).dot(o.edges[i].direction);
    if (along < 0.0 || along > o.edges[i].length) continue;
    const double away = distance_from_line(o.edges[i], x);
    if (away > least) continue;
    least = away;
    edge = i;
  }
  if (edge >= 0) {
    const ShapeFeatures::Edge& e = o.edges[edge];
    found = of(o, pose, first_edge + edge, x, m);
    if (nearby) return nullptr;
    if (std::abs(e.direction.dot(m)) > kSameNormal)
      return polytope ? "a vertex and an edge" : "the end and the side of a capsule";
    // Seen from outside with the edge upward, the left face lies on its left.
    double most = -1.0;
    if (e.left >= 0) most = std::max(most, o.faces[e.left].normal.cross(e.direction).dot(m));
    if (e.right >= 0) most = std::max(most, e.direction.cross(o.faces[e.right].normal).dot(m));
    return most < -kSameNormal ? nullptr : "an edge and a face";
  }
  int face = -1;
  double facing = 0.0;
  for (int f = 0; f < static_cast<int>(o.faces.size()); ++f) {
    if (o.faces[f].normal.dot(m) <= facing) continue;
    facing = o.faces[f].normal.dot(m);
    face = f;
  }
  // Triangles of one plane have one normal: that one which has the point.
  double outside = INFINITY;
  for (int f = 0; f < static_cast<int>(o.faces.size()) && !nearby; ++f) {
    if (o.faces[f].normal.dot(m) <= 0.0 || o.faces[f].normal.cross(m).norm() > kSameNormal) continue;
    if (outside_of(o, o.faces[f], x) >= outside) continue;
    outside = outside_of(o, o.faces[f], x);
    face = f;
  }
  if (face < 0) return "a face and its border";
  const ShapeFeatures::Face& f = o.faces[face];
  found = of(o, pose, first_face + face, x, m);
  if (nearby) return nullptr;
  return f.normal.cross(m).norm() <= kSameNormal && outside_of(o, f, x) < -kMeetingBorder ? nullptr
                                                                                          : "a face and its border";
}

const char* ContactSurface::find_on_cylinder(const ShapeFeatures& o, const Pose& pose, const Vec3& x, const Vec3& m,
                                             bool nearby, ContactSurface& found) {
  const double near = nearby ? kNearby : kMeetingBorder;
  const ShapeFeatures::Edge& axis = o.edges[0];
  const int end = m.dot(o.rims[0].axis) >= 0.0 ? 0 : 1;
  const ShapeFeatures::Rim& rim = o.rims[end];
  const double depth = (rim.center - x).dot(rim.axis), across = distance_from_line(axis, x);
  const double along = m.dot(rim.axis), sine = rim.axis.cross(m).norm();
  if (nearby ? depth > near : along <= kSameNormal) {
    found = of(o, pose, 0, x, m);
    return nearby || (depth > near && axis.length - depth > near) ? nullptr : "the side of a cylinder and a rim";
  }
  if (nearby ? across < rim.radius - near : sine <= kSameNormal) {
    found = of(o, pose, 1 + end, x, m);
    return nearby || across < rim.radius - near ? nullptr : "the end of a cylinder and its rim";
  }
  found = of(o, pose, 3 + end, x, m);
  return nearby || (std::abs(depth) <= near && std::abs(across - rim.radius) <= near)
             ? nullptr
             : "the rim of a cylinder and its end or side";
}

const char* ContactSurface::find(const ShapeFeatures& features, const Pose& pose, const Vec3& x, const Vec3& outward,
                                 bool nearby, ContactSurface& found) {
  if (features.ellipsoid) {
    found = ellipsoid(features.ellipsoid->in(pose.R, pose.p), outward, features.radius);
    return nullptr;
  }
  if (features.is_unbounded()) {
    found = plane("halfspace", x, pose.R * features.faces[0].normal, features.radius);
    return nullptr;
  }
  const Vec3 x_B = pose.into(x), m = pose.R.transpose() * outward;
  return features.rims.empty() ? find_on_polytope(features, pose, x_B, m, nearby, found)
                               : find_on_cylinder(features, pose, x_B, m, nearby, found);
}

}  // namespace contactvi

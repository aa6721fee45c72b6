#include "model/touching_shapes.hpp"

#include <algorithm>

namespace contactvi {

namespace {

using Kind = TouchingShape::Kind;
// Squared sine of the angle between two segments below which they count as parallel: with less, the place where they
// are nearest is known to less than half of the digits.
constexpr double kParallel = 1e-16;
// Of the size of a triangle: nearer to its border than this its inside is nearest. The border between two triangles of
// one face is no feature.
constexpr double kInside = 1e-12;

Vec3 in_world(const TouchPose<double>& pose, const Vec3& x) { return pose.p + pose.R * x; }
Vec3 in_body(const TouchPose<double>& pose, const Vec3& x) { return pose.R.transpose() * (x - pose.p); }

TouchFeature point(const Vec3& p, double sweep) {
  TouchFeature f;
  f.p = p;
  f.sweep = sweep;
  return f;
}

TouchFeature line(const Vec3& p, const Vec3& u, double sweep) {
  TouchFeature f = point(p, sweep);
  f.kind = TouchFeature::Kind::kLine;
  f.u = u;
  return f;
}

TouchFeature plane(const Vec3& p, const Vec3& u) {
  TouchFeature f = point(p, 0.0);
  f.kind = TouchFeature::Kind::kPlane;
  f.u = u;
  return f;
}

// The feature of a segment at the place s along it: an end, or its line.
TouchFeature of_segment(const TouchingShape& shape, double s) {
  const TouchFeature& f = shape.feature;
  if (s <= 0.0) return point(f.p, f.sweep);
  if (s >= shape.length) return point(f.p + shape.length * f.u, f.sweep);
  return f;
}

// The feature of a triangle that is nearest to x, and its distance from it: Ericson, "Real-Time Collision Detection",
// 2005, section 5.1.5.
double nearest_of_triangle(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& n, const Vec3& x,
                           TouchFeature& found) {
  const Vec3 ab = b - a, ac = c - a, ap = x - a, bp = x - b, cp = x - c;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap), d3 = ab.dot(bp), d4 = ac.dot(bp), d5 = ab.dot(cp), d6 = ac.dot(cp);
  const auto corner = [&](const Vec3& p) {
    found = point(p, 0.0);
    return (x - p).norm();
  };
  const auto side = [&](const Vec3& p, const Vec3& along) {
    const Vec3 u = along.normalized();
    found = line(p, u, 0.0);
    return (x - p - u * u.dot(x - p)).norm();
  };
  if (d1 <= 0.0 && d2 <= 0.0) return corner(a);
  if (d3 >= 0.0 && d4 <= d3) return corner(b);
  if (d6 >= 0.0 && d5 <= d6) return corner(c);
  const double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
  const double least = -kInside * std::abs(va + vb + vc);
  if (vc < least && d1 >= 0.0 && d3 <= 0.0) return side(a, ab);
  if (vb < least && d2 >= 0.0 && d6 <= 0.0) return side(a, ac);
  if (va < least && d4 - d3 >= 0.0 && d5 - d6 >= 0.0) return side(b, c - b);
  found = plane(a, n);
  return std::abs(n.dot(ap));
}

// x: in the frame of the polytope's body. Inside of it the plane of the face that is nearest.
TouchFeature of_polytope(const TouchingShape& shape, const Vec3& x) {
  const Polytope& hull = shape.polytope;
  const auto vertex = [&](Eigen::Index face, int k) { return Vec3(hull.vertices.row(hull.faces(face, k))); };
  double highest = -kInfinity;
  Eigen::Index above = 0;
  for (Eigen::Index k = 0; k < hull.faces.rows(); ++k) {
    const double height = shape.normals[static_cast<std::size_t>(k)].dot(x - vertex(k, 0));
    if (height > highest) {
      highest = height;
      above = k;
    }
  }
  const auto swept = [&](TouchFeature f) {
    f.sweep = shape.feature.sweep;
    return f;
  };
  if (highest <= 0.0) return swept(plane(vertex(above, 0), shape.normals[static_cast<std::size_t>(above)]));
  TouchFeature nearest, found;
  double least = kInfinity;
  for (Eigen::Index k = 0; k < hull.faces.rows(); ++k) {
    const Vec3& n = shape.normals[static_cast<std::size_t>(k)];
    const double height = n.dot(x - vertex(k, 0));
    if (!(height > 0.0) || height >= least) continue;  // it does not face x, or its plane is farther away
    const double distance = nearest_of_triangle(vertex(k, 0), vertex(k, 1), vertex(k, 2), n, x, found);
    if (distance < least) {
      least = distance;
      nearest = found;
    }
  }
  return swept(nearest);
}

// The side of a cylinder is its axis swept by its radius.
TouchFeature of_cylinder(const TouchingShape& shape, const Vec3& x) {
  const TouchFeature& axis = shape.feature;
  const double along = axis.u.dot(x - axis.p), beyond = std::max(-along, along - shape.length);
  const double across = (x - axis.p - along * axis.u).norm(), outside = across - axis.sweep;
  const bool first = along < 0.5 * shape.length;
  const Vec3 centre = first ? axis.p : Vec3(axis.p + shape.length * axis.u);
  if (beyond > 0.0 && outside > 0.0) {
    TouchFeature rim = point(centre, 0.0);
    rim.kind = TouchFeature::Kind::kRim;
    rim.u = axis.u;
    rim.radius = axis.sweep;
    return rim;
  }
  if (beyond > outside) return plane(centre, first ? Vec3(-axis.u) : axis.u);
  return axis;
}

// Of a point x of the other shape, in the frame of this one's body.
TouchFeature nearest_to(const TouchingShape& shape, const Vec3& x) {
  switch (shape.kind) {
    case Kind::kSegment:
      return of_segment(shape, shape.feature.u.dot(x - shape.feature.p));
    case Kind::kPolytope:
      return of_polytope(shape, x);
    case Kind::kCylinder:
      return of_cylinder(shape, x);
    default:
      return shape.feature;
  }
}

// Of two segments: Ericson, section 5.1.9. Where they are parallel, the middle of what they have beside each other.
NearestFeatures of_segments(const TouchingShape& a, const TouchingShape& b, const TouchPose<double>& A,
                            const TouchPose<double>& B) {
  const Vec3 ua = A.R * a.feature.u, ub = B.R * b.feature.u;
  const Vec3 apart = in_world(A, a.feature.p) - in_world(B, b.feature.p);
  const double c = ua.dot(ub), da = ua.dot(apart), db = ub.dot(apart), sine = 1.0 - c * c;
  double s = 0.0;
  if (sine > kParallel) {
    s = std::clamp((c * db - da) / sine, 0.0, a.length);
  } else {
    const double first = -da, last = first + c * b.length;
    s = std::clamp(0.5 * (std::clamp(first, 0.0, a.length) + std::clamp(last, 0.0, a.length)), 0.0, a.length);
  }
  double t = db + c * s;
  if (t < 0.0 || t > b.length) {
    t = std::clamp(t, 0.0, b.length);
    s = std::clamp(c * t - da, 0.0, a.length);
  }
  NearestFeatures found{of_segment(a, s), of_segment(b, t)};
  if (sine <= kParallel && found.a.kind == TouchFeature::Kind::kLine && found.b.kind == TouchFeature::Kind::kLine)
    found.a = point(a.feature.p + s * a.feature.u, a.feature.sweep);
  return found;
}

}  // namespace

NearestFeatures nearest_touch(const TouchingShapes& shapes, const TouchPose<double>& a, const TouchPose<double>& b) {
  if (shapes.a.kind == Kind::kSegment && shapes.b.kind == Kind::kSegment) return of_segments(shapes.a, shapes.b, a, b);
  return {shapes.a.feature, nearest_to(shapes.b, in_body(b, in_world(a, shapes.a.feature.p)))};
}

double least_gap(const TouchingShapes& shapes, const TouchPose<double>& a, const TouchPose<double>& b) {
  const Vec3 centre = in_world(a, shapes.a.centre);
  if (shapes.b.kind == Kind::kPlane)
    return (b.R * shapes.b.feature.u).dot(centre - in_world(b, shapes.b.feature.p)) - shapes.a.bound;
  return (centre - in_world(b, shapes.b.centre)).norm() - shapes.a.bound - shapes.b.bound;
}

}  // namespace contactvi

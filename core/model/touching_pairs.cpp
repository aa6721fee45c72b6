// The sides of compliant contacts from coal's shapes.
#include <coal/shape/geometric_shapes.h>

#include <limits>

#include "base/refusal.hpp"
#include "model/hull_access.hpp"
#include "model/scene.hpp"
#include "model/touching_shapes.hpp"

namespace contactvi {

namespace {

using Kind = TouchingShape::Kind;

TouchingShape ball(const Vec3& p, double radius) {
  TouchingShape shape;
  shape.feature.p = shape.centre = p;
  shape.feature.sweep = shape.bound = radius;
  return shape;
}

// From its middle, half its length and its direction.
TouchingShape segment(Kind kind, const Vec3& middle, double half, const Vec3& along, double radius) {
  TouchingShape shape = ball(middle - half * along, radius);
  shape.kind = kind;
  shape.feature.kind = TouchFeature::Kind::kLine;
  shape.feature.u = along;
  shape.length = 2.0 * half;
  shape.centre = middle;
  shape.bound = half + radius;
  return shape;
}

Polytope polytope_of_box(const Vec3& half) {
  Polytope box;
  box.vertices.resize(8, 3);
  for (int k = 0; k < 8; ++k)
    for (int d = 0; d < 3; ++d) box.vertices(k, d) = (k >> d) % 2 == 1 ? half[d] : -half[d];
  box.faces.resize(12, 3);
  box.faces << 0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4, 2, 6, 7, 2, 7, 3, 0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7,
      5;
  return box;
}

TouchingShape polytope(const Polytope& hull, const Mat3& R, const Vec3& p, double sweep, double reach) {
  TouchingShape shape;
  shape.kind = Kind::kPolytope;
  shape.polytope = hull;
  for (Eigen::Index k = 0; k < hull.vertices.rows(); ++k)
    shape.polytope.vertices.row(k) = (R * hull.vertices.row(k).transpose() + p).transpose();
  for (Eigen::Index k = 0; k < hull.faces.rows(); ++k) {
    const auto corner = [&](int i) { return Vec3(shape.polytope.vertices.row(hull.faces(k, i))); };
    shape.normals.push_back((corner(1) - corner(0)).cross(corner(2) - corner(0)).normalized());
  }
  shape.feature.sweep = sweep;
  shape.bound = reach;
  return shape;
}

TouchingShape shape_of_geometry(const Geometry& g) {
  const coal::CollisionGeometry& shape = *g.sharp;
  const Mat3& R = g.R_BG;
  if (shape.getNodeType() == coal::GEOM_HALFSPACE) {
    TouchingShape found;
    found.kind = Kind::kPlane;
    found.feature.kind = TouchFeature::Kind::kPlane;
    found.feature.u = R * g.halfspace_normal;
    found.feature.p = g.p_BG + g.halfspace_offset * found.feature.u;
    found.bound = std::numeric_limits<double>::infinity();
    return found;
  }
  const double sweep = static_cast<const coal::ShapeBase&>(shape).getSweptSphereRadius();
  switch (shape.getNodeType()) {
    case coal::GEOM_SPHERE:
      return ball(g.p_BG, static_cast<const coal::Sphere&>(shape).radius + sweep);
    case coal::GEOM_CAPSULE: {
      const auto& capsule = static_cast<const coal::Capsule&>(shape);
      return segment(Kind::kSegment, g.p_BG, capsule.halfLength, R.col(2), capsule.radius + sweep);
    }
    case coal::GEOM_CYLINDER: {
      const auto& cylinder = static_cast<const coal::Cylinder&>(shape);
      TouchingShape found = segment(Kind::kCylinder, g.p_BG, cylinder.halfLength, R.col(2), cylinder.radius);
      found.bound = g.radius;
      return found;
    }
    case coal::GEOM_ELLIPSOID: {
      TouchingShape found = ball(g.p_BG, sweep);
      found.kind = Kind::kEllipsoid;
      found.feature.kind = TouchFeature::Kind::kEllipsoid;
      found.feature.axes = R * static_cast<const coal::Ellipsoid&>(shape).radii.asDiagonal();
      found.bound = g.radius;
      return found;
    }
    case coal::GEOM_BOX: {
      TouchingShape found =
          polytope(polytope_of_box(static_cast<const coal::Box&>(shape).halfSide), R, g.p_BG, sweep, g.radius);
      found.centre = g.center_B;
      return found;
    }
    default: {
      TouchingShape found = polytope(polytope_of(shape), R, g.p_BG, sweep, g.radius);
      found.centre = g.center_B;
      return found;
    }
  }
}

bool is_swept_cylinder(const Geometry& g) {
  return g.sharp->getNodeType() == coal::GEOM_CYLINDER &&
         static_cast<const coal::ShapeBase&>(*g.sharp).getSweptSphereRadius() > 0.0;
}

// The points that press on a plane; empty: the shape as a whole does.
std::vector<TouchingShape> corners(const TouchingShape& shape) {
  std::vector<TouchingShape> found;
  if (shape.kind == Kind::kSegment)
    for (const double s : {0.0, shape.length})
      found.push_back(ball(shape.feature.p + s * shape.feature.u, shape.feature.sweep));
  if (shape.kind == Kind::kPolytope)
    for (Eigen::Index k = 0; k < shape.polytope.vertices.rows(); ++k)
      found.push_back(ball(shape.polytope.vertices.row(k), shape.feature.sweep));
  return found;
}

}  // namespace

std::vector<TouchingPair> touching_pairs(const Scene& scene, int a, int b, const std::string& name_a,
                                         const std::string& name_b) {
  const Geometry &ga = scene.geometries[a], &gb = scene.geometries[b];
  const TouchingShape first = shape_of_geometry(ga), second = shape_of_geometry(gb);
  const auto fits = [](const TouchingShape& x, const TouchingShape& y) {
    if (y.kind == Kind::kPlane) return x.kind != Kind::kPlane && x.kind != Kind::kCylinder;
    if (x.kind == Kind::kPoint) return y.kind != Kind::kEllipsoid;
    return x.kind == Kind::kSegment && y.kind == Kind::kSegment;
  };
  const bool straight = fits(first, second);
  if ((!straight && !fits(second, first)) || is_swept_cylinder(ga) || is_swept_cylinder(gb))
    throw Refusal(
        "The shapes '" + name_a + "' and '" + name_b + "' cannot be a compliant pair: where they are nearest may jump",
        "a ball against a ball, capsule, box, cylinder, hull or halfspace, two capsules, or a ball, capsule, "
        "ellipsoid, box or hull against a halfspace",
        "other shapes",
        "Let this pair stay rigid: scene.set_compliance(a, b, stiffness=None); or put balls where the softer shape "
        "touches");
  const TouchingShape &x = straight ? first : second, &y = straight ? second : first;
  std::vector<TouchingShape> sides;
  if (y.kind == Kind::kPlane) sides = corners(x);
  if (sides.empty()) sides.push_back(x);
  std::vector<TouchingPair> pairs;
  for (const TouchingShape& side : sides)
    pairs.push_back({std::make_shared<const TouchingShapes>(TouchingShapes{side, y}), !straight});
  return pairs;
}

}  // namespace contactvi

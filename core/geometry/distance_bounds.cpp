#include "geometry/distance_bounds.hpp"

#include <coal/narrowphase/support_functions.h>
#include <coal/shape/geometric_shapes.h>

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {

// Pairs of which something is known at most, 100 kB in all; a power of two. Few pairs are near at one time.
constexpr std::size_t kMostKnown = 1024;

std::size_t size_for(std::size_t pairs) {
  std::size_t size = 1;
  while (size < std::min(pairs, kMostKnown)) size *= 2;
  return size;
}

Vec3 into(const PosedShape& shape, const Vec3& x_W) { return shape.R.transpose() * (x_W - shape.p); }
Vec3 point(const PosedShape& shape, const Vec3& x) { return shape.R * x + shape.p; }

}  // namespace

struct DistanceBounds::Workspace {
  coal::details::ShapeSupportData hull;
};

DistanceBounds::DistanceBounds(std::size_t pairs) : known_(size_for(pairs)), workspace_(new Workspace) {}

DistanceBounds::~DistanceBounds() = default;

void DistanceBounds::forget() {
  for (Known& known : known_) known.pair = -1;
}

void DistanceBounds::keep(int pair, const PosedShape& a, const PosedShape& b, const Contact& contact) {
  if (!(contact.gap > 0.0)) return;
  place_of(pair) = {pair,
                    a.R.transpose() * contact.normal,
                    b.R.transpose() * contact.normal,
                    into(a, contact.point_a),
                    into(b, contact.point_b),
                    0,
                    0};
}

DistanceBounds::Bounds DistanceBounds::find(int pair, const PosedShape& a, const PosedShape& b) {
  Known& known = place_of(pair);
  if (known.pair != pair) return {-kInfinity, kInfinity};
  const auto between = [&](const Vec3& direction_W) {
    return -extent(b, -direction_W, known.vertex_b) - extent(a, direction_W, known.vertex_a);
  };
  Bounds bounds{between(a.R * known.direction_a), (point(b, known.point_b) - point(a, known.point_a)).norm()};
  if (!is_close(bounds)) bounds.lower = std::max(bounds.lower, between(b.R * known.direction_b));
  return bounds;
}

// How far a shape reaches along a unit vector, from the origin of the world. vertex: of a hull, near the farthest one,
// then that.
double DistanceBounds::extent(const PosedShape& posed, const Vec3& direction_W, int& vertex) {
  const Vec3 d = posed.R.transpose() * direction_W;
  const auto& shape = static_cast<const coal::ShapeBase&>(*posed.shape);
  double core = kInfinity;
  switch (shape.getNodeType()) {
    case coal::GEOM_BOX:
      core = static_cast<const coal::Box&>(shape).halfSide.dot(d.cwiseAbs());
      break;
    case coal::GEOM_SPHERE:
      core = static_cast<const coal::Sphere&>(shape).radius;
      break;
    case coal::GEOM_CAPSULE: {
      const auto& capsule = static_cast<const coal::Capsule&>(shape);
      core = capsule.halfLength * std::abs(d[2]) + capsule.radius;
      break;
    }
    case coal::GEOM_CYLINDER: {
      const auto& cylinder = static_cast<const coal::Cylinder&>(shape);
      core = cylinder.halfLength * std::abs(d[2]) + cylinder.radius * std::sqrt(d[0] * d[0] + d[1] * d[1]);
      break;
    }
    case coal::GEOM_ELLIPSOID:
      // The rounded one has the half axes of the sharp one and is a little larger (model/rounding.cpp).
      core = (static_cast<const coal::Ellipsoid&>(shape).radii.array() + shape.getSweptSphereRadius())
                 .matrix()
                 .cwiseProduct(d)
                 .norm();
      return posed.p.dot(direction_W) + core;
    case coal::GEOM_CONVEX: {
      coal::Vec3s support;
      workspace_->hull.last_dir = d;  // coal goes on from the vertex
      coal::details::getShapeSupport<coal::details::NoSweptSphere>(static_cast<const coal::ConvexBase*>(&shape), d,
                                                                   support, vertex, workspace_->hull);
      core = support.dot(d);
      break;
    }
    default:
      break;
  }
  return posed.p.dot(direction_W) + core + shape.getSweptSphereRadius();
}

}  // namespace contactvi

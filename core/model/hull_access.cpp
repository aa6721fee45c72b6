#include "model/hull_access.hpp"

#include <coal/shape/convex.h>

#include <memory>
#include <vector>

#include "base/error.hpp"

namespace contactvi {

using Hull = coal::Convex<coal::Triangle>;

Polytope polytope_of(const coal::CollisionGeometry& shape) {
  const auto* hull = dynamic_cast<const Hull*>(&shape);
  if (hull == nullptr || !hull->polygons) throw Error("a convex shape has no triangles");
  Polytope result;
  result.vertices.resize(hull->num_points, 3);
  for (unsigned i = 0; i < hull->num_points; ++i) result.vertices.row(i) = (*hull->points)[i];
  result.faces.resize(hull->num_polygons, 3);
  for (unsigned i = 0; i < hull->num_polygons; ++i)
    for (int k = 0; k < 3; ++k) result.faces(i, k) = static_cast<int>((*hull->polygons)[i][k]);
  return result;
}

Polytope hull_of(const double* points, std::size_t count) {
  auto copy = std::make_shared<std::vector<coal::Vec3s>>();
  copy->reserve(count);
  for (std::size_t i = 0; i < count; ++i) copy->emplace_back(points[3 * i], points[3 * i + 1], points[3 * i + 2]);
  const std::unique_ptr<coal::ConvexBase> hull(
      coal::ConvexBase::convexHull(copy, static_cast<unsigned>(count), true, "Qt"));
  return polytope_of(*hull);
}

void set_polytope(coal::CollisionGeometry& shape, const Polytope& polytope) {
  auto* hull = dynamic_cast<Hull*>(&shape);
  if (hull == nullptr) throw Error("a convex shape has no triangles");
  *hull = static_cast<const Hull&>(*shape_of(polytope));  // takes over its arrays
}

}  // namespace contactvi

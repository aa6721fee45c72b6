#include "model/hull_access.hpp"

#include <coal/shape/convex.h>

#include <algorithm>

#include "base/error.hpp"
#include "model/polytope_shape.hpp"

namespace contactvi {

using Hull = coal::Convex<coal::Triangle>;

unsigned vertex_count(const Hull& hull) {
  std::size_t count = 0;
  for (const coal::Triangle& t : *hull.polygons)
    for (int k = 0; k < 3; ++k) count = std::max(count, t[k] + 1);
  return static_cast<unsigned>(count);
}

Polytope polytope_of(const coal::CollisionGeometry& shape) {
  const auto* hull = dynamic_cast<const Hull*>(&shape);
  if (hull == nullptr || !hull->polygons) throw Error("a convex shape has no triangles");
  Polytope result;
  result.faces.resize(hull->num_polygons, 3);
  for (unsigned i = 0; i < hull->num_polygons; ++i)
    for (int k = 0; k < 3; ++k) result.faces(i, k) = static_cast<int>((*hull->polygons)[i][k]);
  const unsigned count = vertex_count(*hull);
  result.vertices.resize(count, 3);
  for (unsigned i = 0; i < count; ++i) result.vertices.row(i) = (*hull->points)[i];
  return result;
}

void set_polytope(coal::CollisionGeometry& shape, const Polytope& polytope) {
  auto* hull = dynamic_cast<Hull*>(&shape);
  if (hull == nullptr) throw Error("a convex shape has no triangles");
  *hull = static_cast<const Hull&>(*plain_shape_of(polytope));  // takes over its arrays
}

}  // namespace contactvi

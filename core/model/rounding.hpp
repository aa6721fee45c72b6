// Rounded copies of sharp shapes: shrunk by r, then swept by a sphere of radius r.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "model/polytope.hpp"

namespace coal {
class CollisionGeometry;
}

namespace contactvi {

struct Geometry;

// A polytope shrunk by radius [m].
struct ShrunkHull {
  Polytope hull;
  double radius;
};

// Where rounded hulls are kept from one process to the next; called in one thread.
class RoundedHulls {
 public:
  virtual ~RoundedHulls() = default;
  // The hull shrunk by at most radius [m], if it is known.
  virtual std::optional<ShrunkHull> find(const Polytope& hull, double radius) = 0;
  virtual void keep(const Polytope& hull, double radius, const ShrunkHull& shrunk) = 0;
};

// The shape shrunk by at most radius, to be swept by a sphere of that radius; null for shapes that need none. Lowers
// radius where the shape is too thin for it, and sets that of an ellipsoid, which has no edges.
std::shared_ptr<coal::CollisionGeometry> shrunk_shape(const coal::CollisionGeometry& shape, double& radius);

// Makes the rounded shapes of these geometries, in several threads, one for those that share their sharp shape. `known`
// may be null. Throws Refusal, which names the geometry, for a hull that cannot be rounded.
void round_shapes(const std::vector<Geometry*>& geometries, const std::vector<std::string>& names, RoundedHulls* known);

}  // namespace contactvi

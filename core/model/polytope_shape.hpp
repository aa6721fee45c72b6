// Convex polytopes as coal's shapes.
#pragma once

#include <memory>

#include "model/polytope.hpp"

namespace coal {
class CollisionGeometry;
}

namespace contactvi {

// Coal's shape of a polytope, equal to the one that coal's own constructor makes, but for a vertex with more neighbours
// than coal can count: behind the vertices come helpers of it, which are corners of no triangle (crowded_vertex.hpp).
// Throws Error for indices of no vertex.
std::shared_ptr<coal::CollisionGeometry> shape_of(const Polytope& polytope);

// The same with the vertices alone: of the neighbours of such a vertex some are left out, so that coal's distances to
// it are right to the angle between its edges only. For shapes that are handed on, not for distances.
std::shared_ptr<coal::CollisionGeometry> plain_shape_of(const Polytope& polytope);

// The most neighbours of a vertex.
int most_neighbors(const Polytope& polytope);

// How many vertices of a polytope get helpers in shape_of.
int count_crowded(const Polytope& polytope);

}  // namespace contactvi

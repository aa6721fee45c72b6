// The vertices and triangles of coal's hulls, read and set at once; from Python coal gives and takes them one by one.
#pragma once

#include "model/polytope.hpp"

namespace contactvi {

// Throws Error for a shape that is no hull with triangles.
Polytope polytope_of(const coal::CollisionGeometry& shape);

// The hull of points (x y z, one after the other), with coal's order of its vertices and triangles. The points have to
// have a volume: coal ends the process where they are in one plane. Throws what coal throws.
Polytope hull_of(const double* points, std::size_t count);

// Makes a hull that of a polytope. Throws Error for a shape that is no hull with triangles, and like shape_of.
void set_polytope(coal::CollisionGeometry& shape, const Polytope& polytope);

}  // namespace contactvi

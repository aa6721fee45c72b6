// The vertices and triangles of coal's hulls, read and set at once; from Python coal gives and takes them one by one.
#pragma once

#include "model/polytope.hpp"

namespace contactvi {

// Throws Error for a shape that is no hull with triangles. Vertices behind the last corner of a triangle are left out:
// they are helpers (shape_of).
Polytope polytope_of(const coal::CollisionGeometry& shape);

// Makes a hull that of a polytope. Throws Error for a shape that is no hull with triangles, and like plain_shape_of.
void set_polytope(coal::CollisionGeometry& shape, const Polytope& polytope);

}  // namespace contactvi

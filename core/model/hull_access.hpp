// The vertices and triangles of coal's hulls, read and set at once; from Python coal gives and takes them one by one.
#pragma once

#include <coal/shape/convex.h>

#include "model/polytope.hpp"

namespace contactvi {

// The number of vertices of a hull: points behind the last corner of a triangle are helpers (shape_of).
unsigned vertex_count(const coal::Convex<coal::Triangle>& hull);

// Without helpers. Throws Error for a shape that is no hull with triangles.
Polytope polytope_of(const coal::CollisionGeometry& shape);

// Makes a hull that of a polytope. Throws Error for a shape that is no hull with triangles, and like plain_shape_of.
void set_polytope(coal::CollisionGeometry& shape, const Polytope& polytope);

}  // namespace contactvi

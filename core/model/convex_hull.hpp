// Convex hulls of points. Coal's own function ends the process for points in one plane, and refuses hulls with a vertex
// of more neighbours than it can count.
#pragma once

#include <cstddef>
#include <vector>

#include "model/polytope.hpp"

namespace contactvi {

// The numbers, ascending, of the points (x y z, one after the other) that are vertices of the hull of all; none where
// qhull finds no hull: fewer than four points, or all in one plane.
std::vector<int> hull_vertices(const double* points, std::size_t count);

// The hull of such points as triangles, its vertices and triangles in the order in which coal has them; without any
// where qhull finds none.
Polytope hull_of(const double* points, std::size_t count);

// The same, and the plane normal . x = offset of each triangle (normal, offset), that of the whole face of which it is
// a part: the plane of a slender triangle itself is lost in the rounding.
using Planes = Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor>;
Polytope hull_of(const double* points, std::size_t count, Planes& planes);

}  // namespace contactvi

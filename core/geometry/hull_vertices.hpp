// Which of many points are vertices of their convex hull.
#pragma once

#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

// The numbers, ascending, of the points (x y z, one after the other) that are vertices of the hull of all; none where
// qhull finds no hull: fewer than four points, or all in one plane.
std::vector<int> hull_vertices(const double* points, int count);

}  // namespace contactvi

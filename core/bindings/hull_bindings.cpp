// Convex hulls of points, for the import of meshes.
#include <nanobind/eigen/dense.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <limits>

#include "base/error.hpp"
#include "bindings/arrays.hpp"
#include "bindings/expose.hpp"
#include "geometry/hull_vertices.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

using Points = nb::ndarray<const double, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;

IntVec vertices_of(const Points& points) {
  if (points.shape(0) > static_cast<std::size_t>(std::numeric_limits<int>::max() / 3)) throw Error("too many points");
  const std::vector<int> found = hull_vertices(points.data(), static_cast<int>(points.shape(0)));
  IntVec result(static_cast<Eigen::Index>(found.size()));
  std::copy(found.begin(), found.end(), result.data());
  return result;
}

}  // namespace

void expose_hull(nb::module_& m) {
  m.def("hull_vertices", &vertices_of, "points"_a,
        "Ascending indices of the points (n, 3), finite, that are vertices of their convex hull; none without a hull.");
}

}  // namespace contactvi

// Convex hulls of points, for the import of meshes.
#include <nanobind/eigen/dense.h>
#include <nanobind/ndarray.h>

#include <coal/shape/convex.h>

#include <algorithm>
#include <cstdint>
#include <limits>

#include "base/error.hpp"
#include "bindings/arrays.hpp"
#include "bindings/expose.hpp"
#include "geometry/hull_vertices.hpp"
#include "model/hull_access.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

using Points = nb::ndarray<const double, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;

int count_of(const Points& points) {
  if (points.shape(0) > static_cast<std::size_t>(std::numeric_limits<int>::max() / 3)) throw Error("too many points");
  return static_cast<int>(points.shape(0));
}

// Hulls are found without Python's lock, beside other meshes that are read or hulled. Each has a state of qhull of its
// own.
IntVec vertices_of(const Points& points) {
  const int count = count_of(points);
  const std::vector<int> found = [&] {
    const nb::gil_scoped_release release;
    return hull_vertices(points.data(), count);
  }();
  IntVec result(static_cast<Eigen::Index>(found.size()));
  std::copy(found.begin(), found.end(), result.data());
  return result;
}

nb::typed<nb::tuple, decltype(Polytope::vertices), decltype(Polytope::faces)> hull_of_points(const Points& points) {
  const int count = count_of(points);
  const Polytope hull = [&] {
    const nb::gil_scoped_release release;
    return hull_of(points.data(), static_cast<std::size_t>(count));
  }();
  return nb::make_tuple(hull.vertices, hull.faces);
}

// The hull that a coal.Convex of Python holds, from the address that its id() tells.
coal::Convex<coal::Triangle>& hull_at(std::uintptr_t address) {
  return *reinterpret_cast<coal::Convex<coal::Triangle>*>(address);
}

}  // namespace

void expose_hull(nb::module_& m) {
  m.def("hull_vertices", &vertices_of, "points"_a,
        "Ascending indices of the points (n, 3), finite, that are vertices of their convex hull; none without a hull.");
  m.def("hull_of_points", &hull_of_points, "points"_a,
        "Vertices (n, 3) and triangles (m, 3) of the hull that coal makes of points, which must have a volume.");
  m.def(
      "hull_faces", [](std::uintptr_t hull) { return polytope_of(hull_at(hull)).faces; }, "hull"_a,
      "Triangles (m, 3) of a coal.Convex, of which hull is the id().");
  m.def(
      "set_hull",
      [](std::uintptr_t hull, const decltype(Polytope::vertices)& vertices, const decltype(Polytope::faces)& faces) {
        set_polytope(hull_at(hull), {vertices, faces});
      },
      "hull"_a, "vertices"_a, "faces"_a,
      "Gives a coal.Convex, of which hull is the id(), vertices (n, 3) and outward triangles (m, 3).");
}

}  // namespace contactvi

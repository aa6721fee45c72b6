// Convex hulls of points, for the import of meshes.
#include <nanobind/eigen/dense.h>
#include <nanobind/ndarray.h>

#include <coal/shape/convex.h>

#include <algorithm>
#include <cstdint>

#include "bindings/arrays.hpp"
#include "bindings/expose.hpp"
#include "model/convex_hull.hpp"
#include "model/crowded_vertex.hpp"
#include "model/hull_access.hpp"
#include "model/polytope_shape.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

using Points = nb::ndarray<const double, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;

// Hulls are found without Python's lock, beside other meshes that are read or hulled. Each has a state of qhull of its
// own.
IntVec vertices_of(const Points& points) {
  const std::size_t count = points.shape(0);
  const std::vector<int> found = [&] {
    const nb::gil_scoped_release release;
    return hull_vertices(points.data(), count);
  }();
  IntVec result(static_cast<Eigen::Index>(found.size()));
  std::copy(found.begin(), found.end(), result.data());
  return result;
}

nb::typed<nb::tuple, decltype(Polytope::vertices), decltype(Polytope::faces)> hull_of_points(const Points& points) {
  const std::size_t count = points.shape(0);
  const Polytope hull = [&] {
    const nb::gil_scoped_release release;
    return hull_of(points.data(), count);
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
        "Vertices (n, 3) and triangles (m, 3) of the hull of points, finite, in coal's order; none where there is no "
        "hull.");
  m.def(
      "hull_faces", [](std::uintptr_t hull) { return polytope_of(hull_at(hull)).faces; }, "hull"_a,
      "Triangles (m, 3) of a coal.Convex, of which hull is the id().");
  m.def(
      "crowded_vertices",
      [](const decltype(Polytope::vertices)& vertices, const decltype(Polytope::faces)& faces) {
        return count_crowded({vertices, faces});
      },
      "vertices"_a, "faces"_a,
      "How many vertices of a hull have more edges than coal can count: distances there are right to HULL_ERROR.");
  m.def(
      "neighbor_lists",
      [](const decltype(Polytope::vertices)& vertices, const decltype(Polytope::faces)& faces) {
        const auto shape = shape_of({vertices, faces});
        const auto& hull = static_cast<const coal::Convex<coal::Triangle>&>(*shape);
        nb::typed<nb::list, nb::typed<nb::list, int>> lists;
        decltype(Polytope::vertices) points(hull.num_points, 3);
        for (unsigned i = 0; i < hull.num_points; ++i) {
          points.row(i) = (*hull.points)[i];
          nb::typed<nb::list, int> list;
          const auto& own = (*hull.neighbors)[i];
          for (int k = 0; k < own.count(); ++k) list.append(own[k]);
          lists.append(list);
        }
        return nb::typed<nb::tuple, decltype(Polytope::vertices), decltype(lists)>(nb::make_tuple(points, lists));
      },
      "vertices"_a, "faces"_a,
      "Points of the engine's copy of a hull, its vertices and their helpers, and the neighbours of each, for tests.");
  m.attr("HULL_ERROR") = kOutside;  // in sizes of the hull
  m.def(
      "set_hull",
      [](std::uintptr_t hull, const decltype(Polytope::vertices)& vertices, const decltype(Polytope::faces)& faces) {
        set_polytope(hull_at(hull), {vertices, faces});
      },
      "hull"_a, "vertices"_a, "faces"_a,
      "Gives a coal.Convex, of which hull is the id(), vertices (n, 3) and outward triangles (m, 3).");
}

}  // namespace contactvi

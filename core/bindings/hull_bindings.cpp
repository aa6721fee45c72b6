// Convex hulls of points, for the import of meshes.
#include <nanobind/eigen/dense.h>
#include <nanobind/ndarray.h>

#include <coal/shape/convex.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "base/worker_threads.hpp"
#include "bindings/arrays.hpp"
#include "bindings/expose.hpp"
#include "model/convex_hull.hpp"
#include "model/crowded_vertex.hpp"
#include "model/hull_access.hpp"
#include "model/mesh_distance.hpp"
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

using Triangles = nb::ndarray<const int, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;

// Of many points, those of a row of a grid one after the other: the distance of the last one bounds that of the next.
VecX mesh_distances(const Points& vertices, const Triangles& faces, const Points& points) {
  using Rows = Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>>;
  using Indices = Eigen::Map<const Eigen::Matrix<int, Eigen::Dynamic, 3, Eigen::RowMajor>>;
  const Rows corners(vertices.data(), static_cast<Eigen::Index>(vertices.shape(0)), 3),
      places(points.data(), static_cast<Eigen::Index>(points.shape(0)), 3);
  const Indices triangles(faces.data(), static_cast<Eigen::Index>(faces.shape(0)), 3);
  VecX distances(places.rows());
  const nb::gil_scoped_release release;
  const MeshDistance mesh(corners, triangles);
  constexpr Eigen::Index kPart = 4096;
  in_parallel(static_cast<int>((places.rows() + kPart - 1) / kPart), [&](int part) {
    double last = std::numeric_limits<double>::infinity();
    for (Eigen::Index i = part * kPart; i < std::min(places.rows(), (part + 1) * kPart); ++i) {
      const Vec3 x = places.row(i).transpose();
      // With some room for rounding.
      const double step = i > part * kPart ? (x.transpose() - places.row(i - 1)).norm() : last;
      last = distances[i] = mesh.of(x, (std::abs(last) + step) * (1.0 + 1e-9));
    }
  });
  return distances;
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
  m.def("mesh_distances", &mesh_distances, "vertices"_a, "faces"_a, "points"_a,
        "Signed distances (k,) of points (k, 3) from a closed mesh of outward triangles, negative inside.");
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

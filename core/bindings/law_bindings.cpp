// Laws of contact of single pairs: added once, before any simulator is made.
#include <coal/shape/geometric_shapes.h>
#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <tuple>
#include <utility>
#include <variant>
#include <vector>

#include "base/error.hpp"
#include "bindings/expose.hpp"
#include "bindings/user_functions.hpp"
#include "impact/incremental_impact.hpp"
#include "model/common_normals.hpp"
#include "model/cylinder_normals.hpp"
#include "model/function_surface.hpp"
#include "model/height_field.hpp"
#include "model/implicit_surface.hpp"
#include "model/restitution.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

using Table = std::pair<std::vector<double>, std::vector<double>>;
using OfNumber = nb::typed<nb::callable, double(double)>;
using Address = std::uintptr_t;  // of a C function double(double)
using Given = std::variant<Table, Address, OfNumber>;

std::function<double(double)> function_of(Scene& s, const Given& given) {
  if (const Address* address = std::get_if<Address>(&given))
    return reinterpret_cast<double (*)(double)>(*address);  // NOLINT: the caller says what is there
  return [call = keep(s, std::get<OfNumber>(given))](double place) {
    if (!std::isfinite(place)) return std::numeric_limits<double>::quiet_NaN();  // of an iteration that diverges
    return guarded(call, std::numeric_limits<double>::quiet_NaN(), [&] { return nb::cast<double>(call(place)); });
  };
}

// A function of the state of a contact that was added to the scene before.
std::shared_ptr<const ContactFunction> state_function(const Scene& s, std::optional<int> number) {
  if (!number) return nullptr;
  const auto& all = s.tree.elements.contact_functions;
  if (*number < 0 || *number >= static_cast<int>(all.size())) throw Error("there is no such function of contacts");
  return all[static_cast<std::size_t>(*number)];
}

// Stands for a coefficient of restitution that depends on the speed: neither plastic nor elastic.
constexpr double kVaries = 0.5;

NumberFunction number_function(Scene& s, const std::optional<Given>& value) {
  if (!value) return {};
  if (const Table* table = std::get_if<Table>(&*value)) {
    if (table->first.empty() || table->first.size() != table->second.size())
      throw Error("a table needs as many values as places");
    return {table->first, table->second};
  }
  return NumberFunction(function_of(s, *value));
}

void set_contact_law(Scene& s, const std::vector<int>& pairs, int restitution, bool incremental, bool keeps_energy,
                     double tangential, const std::optional<Given>& e, const std::optional<Given>& mu,
                     std::optional<double> static_mu, const std::optional<Given>& pull, int axis_of, const Vec3& axis,
                     const Eigen::Vector2d& shares, double spinning, double rolling, const std::vector<int>& body_pulls,
                     std::optional<int> e_of_state, std::optional<int> mu_of_state) {
  ContactLaw law;
  if (body_pulls.size() > 2) throw Error("a pair has two bodies");
  for (std::size_t k = 0; k < body_pulls.size(); ++k) {
    if (body_pulls[k] < 0 || body_pulls[k] >= static_cast<int>(s.body_pulls.size())) throw Error("no such adhesion");
    law.body_pulls[k] = body_pulls[k];
  }
  law.mu = number_function(s, mu);
  if (static_mu) law.static_mu = *static_mu;
  law.pull = number_function(s, pull);
  law.axis_of = axis_of;
  law.axis = axis;
  law.shares = shares;
  if (restitution < 0 || restitution > 2) throw Error("there is no such law of restitution");
  law.restitution = static_cast<RestitutionLaw>(restitution);
  law.incremental = incremental;
  law.keeps_energy = keeps_energy;
  law.tangential = tangential;
  law.spinning = spinning;
  law.rolling = rolling;
  law.e = number_function(s, e);
  law.e_of_state = state_function(s, e_of_state);
  law.mu_of_state = state_function(s, mu_of_state);
  for (const int pair : pairs) {
    if (pair < 0 || pair >= static_cast<int>(s.pairs.size())) throw Error("there is no such pair");
    Pair& taken = s.pairs[static_cast<std::size_t>(pair)];
    taken.law = static_cast<int>(s.laws.size());
    if (restitution_varies(law)) taken.restitution = kVaries;
  }
  s.laws.push_back(std::move(law));
}

using Number = nb::ndarray<const double, nb::numpy, nb::ndim<2>, nb::c_contig>;
using OfPoints = nb::typed<nb::callable, nb::object(nb::object)>;
using OfPoint = nb::typed<nb::callable, nb::object(Vec3)>;
using GivenSurface = std::variant<Address, OfPoints>;

// Rows of values at rows of coordinates, by a function of Python that takes and returns arrays.
template <int kCoordinates, int kValues>
std::function<void(const double*, int, double*)> rows_by(Scene& s, const OfPoints& function) {
  return [call = keep(s, function)](const double* points, int count, double* values) {
    guarded(call, false, [&] {
      const std::size_t shape[2] = {static_cast<std::size_t>(count), kCoordinates};
      nb::ndarray<nb::numpy, const double> given(points, 2, shape, nb::handle());
      const auto result = nb::cast<Number>(call(given.cast(nb::rv_policy::copy)));
      if (result.shape(0) != shape[0] || result.shape(1) != kValues) throw Error("a surface of another shape");
      std::copy_n(result.data(), kValues * shape[0], values);
      return true;
    });
  };
}

FunctionSurface::Lost lost_of(Scene& s, const OfPoint& tell) {
  return [call = keep(s, tell)](const Vec3& point) {
    guarded(call, false, [&] {
      call(point);
      throw Error("nothing was raised");
      return true;
    });
  };
}

std::shared_ptr<const FunctionSurface> surface_of(Scene& s, const GivenSurface& given, bool is_height,
                                                  const OfPoint& tell) {
  const FunctionSurface::Lost lost = lost_of(s, tell);
  if (const OfPoints* function = std::get_if<OfPoints>(&given)) {
    if (is_height) return std::make_shared<HeightSurface>(rows_by<2, HeightSurface::kValues>(s, *function), lost);
    return std::make_shared<DistanceSurface>(rows_by<3, DistanceSurface::kValues>(s, *function), lost);
  }
  const Address address = std::get<Address>(given);
  if (is_height) {
    auto* height = reinterpret_cast<void (*)(double, double, double*)>(address);  // NOLINT: the caller knows
    return std::make_shared<HeightSurface>(
        [height](const double* xy, int count, double* values) {
          for (int i = 0; i < count; ++i) height(xy[2 * i], xy[2 * i + 1], values + HeightSurface::kValues * i);
        },
        lost);
  }
  auto* distance = reinterpret_cast<void (*)(double, double, double, double*)>(address);  // NOLINT: the same
  return std::make_shared<DistanceSurface>(
      [distance](const double* xyz, int count, double* values) {
        for (int i = 0; i < count; ++i)
          distance(xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2], values + DistanceSurface::kValues * i);
      },
      lost);
}

// Puts a surface in the place of a halfspace.
void put_surface(Scene& s, int geometry, double reach, std::shared_ptr<const FunctionSurface> surface) {
  if (geometry < 0 || geometry >= static_cast<int>(s.geometries.size())) throw Error("there is no such geometry");
  Geometry& g = s.geometries[static_cast<std::size_t>(geometry)];
  if (!g.unbounded) throw Error("a surface stands in the place of a halfspace");
  g.surface = std::move(surface);
  // No plane bounds it.
  g.halfspace_offset = std::numeric_limits<double>::infinity();
  g.reach = reach;
}

void set_surface(Scene& s, int geometry, const GivenSurface& given, bool is_height, double reach, const OfPoint& tell) {
  put_surface(s, geometry, reach, surface_of(s, given, is_height, tell));
}

// An ellipsoid that meets a solid or a height field has a level set, too.
void make_solid(Geometry& g, const FunctionSurface::Lost& lost) {
  if (g.solid || g.sharp->getNodeType() != coal::GEOM_ELLIPSOID) return;
  const Vec3 radii = static_cast<const coal::Ellipsoid&>(*g.sharp).radii, half = 1.1 * radii;
  const Eigen::Vector3i cells = (half / (0.125 * radii.minCoeff())).array().ceil().cast<int>();
  g.solid =
      std::make_shared<ImplicitSurface>(superellipsoid(radii, 2.0), false, BoxTree::Box(-half, half), cells, lost);
}

void make_solids_of_partners(Scene& s, int geometry, const FunctionSurface::Lost& lost) {
  for (const Pair& pair : s.pairs)
    for (const auto& [one, other] : {std::pair(pair.a, pair.b), std::pair(pair.b, pair.a)})
      if (one == geometry) make_solid(s.geometries[static_cast<std::size_t>(other)], lost);
}

void set_height_field(Scene& s, int geometry, const MatX& coefficients, const Eigen::Vector2d& corner,
                      const Eigen::Vector2d& spacing, double reach, const OfPoint& tell) {
  if (coefficients.rows() < 4 || coefficients.cols() < 4) throw Error("a height field needs four coefficients");
  const auto field = std::make_shared<HeightField>(coefficients, corner, spacing, lost_of(s, tell));
  put_surface(s, geometry, reach, field);
  s.geometries[static_cast<std::size_t>(geometry)].field = field;
  make_solids_of_partners(s, geometry, lost_of(s, tell));
}

using Corner = Eigen::Vector3d;

// Where a level set is the surface of a solid, or of all but that: whether it is hollow, the low and high corner of a
// grid and its cells along each axis.
using Cells = std::tuple<bool, Corner, Corner, Eigen::Vector3i>;

void put_level_set(Scene& s, int geometry, std::unique_ptr<const LevelSet> level, const Cells& cells, double reach,
                   const OfPoint& tell) {
  const auto& [hollow, low, high, counts] = cells;
  const BoxTree::Box box(low, high);
  const auto solid = std::make_shared<ImplicitSurface>(std::move(level), hollow, box, counts, lost_of(s, tell));
  put_surface(s, geometry, reach, solid);
  Geometry& g = s.geometries[static_cast<std::size_t>(geometry)];
  g.solid = solid;
  g.reaches = !hollow;
  g.radius = 0.5 * box.sizes().norm();
  g.center_B = g.p_BG + g.R_BG * box.center();
  make_solids_of_partners(s, geometry, lost_of(s, tell));
}

void set_spline_solid(Scene& s, int geometry, std::vector<double> coefficients, const Cells& cells, double reach,
                      const OfPoint& tell) {
  const auto& [hollow, low, high, counts] = cells;
  const Eigen::Vector3i splines = counts.array() + 3;
  if (static_cast<Eigen::Index>(coefficients.size()) != splines.prod()) throw Error("coefficients for other cells");
  const Corner spacing = (high - low).cwiseQuotient(counts.cast<double>());
  put_level_set(s, geometry, spline_level_set(std::move(coefficients), splines, low, spacing), cells, reach, tell);
}

// Rows of distance, normal of the nearest foot of a point and of those nearer than reach, in the frame of the surface.
MatX feet_of(const Scene& s, int geometry, const Corner& point, double reach) {
  const FunctionSurface* surface = s.geometries.at(static_cast<std::size_t>(geometry)).surface.get();
  if (surface == nullptr) throw Error("there is no such surface");
  std::vector<SurfaceFoot> feet;
  surface->all_feet(point, reach, feet);
  MatX rows(static_cast<Eigen::Index>(feet.size()), 4);
  for (Eigen::Index k = 0; k < rows.rows(); ++k) {
    const SurfaceFoot& foot = feet[static_cast<std::size_t>(k)];
    rows.row(k) << foot.distance, foot.normal.transpose();
  }
  return rows;
}

// Rows of gap, normal and the places of the common normals of two shapes, the second one at R x + t in the frame of the
// first one: the least one, and those with a gap up to reach. Of a cylinder also its part, and how far the place is
// from the border of that.
MatX common_normals_of(const Scene& s, int first, int second, const Mat3& R, const Vec3& t, double reach) {
  const Geometry &one = s.geometries.at(static_cast<std::size_t>(first)),
                 &other = s.geometries.at(static_cast<std::size_t>(second));
  const SearchedSurface* surface = one.field ? static_cast<const SearchedSurface*>(one.field.get()) : one.solid.get();
  const bool is_cylinder = other.sharp->getNodeType() == coal::GEOM_CYLINDER;
  if (surface == nullptr || !(is_cylinder || other.solid)) throw Error("there is no such solid");
  std::vector<CommonNormal> found;
  std::vector<int> number;
  std::vector<double> depth;  // in the part of a cylinder
  if (is_cylinder) {
    const auto& shape = static_cast<const coal::Cylinder&>(*other.sharp);
    const CylinderNormals normals(*surface, {shape.radius, shape.halfLength}, R, t);
    normals.all({}, reach, found, number);
    for (const CommonNormal& c : found) depth.push_back(normals.depth(c));
  } else {
    CommonNormals({surface, Vec3::UnitZ(), 0.0}, *other.solid, R, t).all({}, reach, found, number);
  }
  MatX rows(static_cast<Eigen::Index>(found.size()), is_cylinder ? 12 : 10);
  for (Eigen::Index k = 0; k < rows.rows(); ++k) {
    const CommonNormal& c = found[static_cast<std::size_t>(k)];
    rows.row(k).head<10>() << c.gap, c.normal.transpose(), c.first.transpose(), c.second.transpose();
    if (is_cylinder) rows.row(k).tail<2>() << c.part, depth[static_cast<std::size_t>(k)];
  }
  return rows;
}

void set_surface_motion(Scene& s, int geometry, const Vec3& linear, const Vec3& angular,
                        const std::optional<Given>& profile) {
  if (geometry < 0 || geometry >= static_cast<int>(s.geometries.size())) throw Error("there is no such geometry");
  s.geometries[static_cast<std::size_t>(geometry)].motion = static_cast<int>(s.surface_motions.size());
  s.surface_motions.push_back({linear, angular, number_function(s, profile)});
  for (Pair& pair : s.pairs) pair.moves |= pair.a == geometry || pair.b == geometry;
}

}  // namespace

void expose_laws(nb::module_& m, nb::class_<Scene>& scene) {
  scene.def(
      "set_contact_law", &set_contact_law, "pairs"_a, "restitution"_a, "incremental"_a, "keeps_energy"_a,
      "tangential"_a, "e"_a.none(), "mu"_a.none(), "static_mu"_a.none(), "pull"_a.none(), "axis_of"_a, "axis"_a,
      "shares"_a, "spinning"_a, "rolling"_a, "body_pulls"_a, "e_of_state"_a.none(), "mu_of_state"_a.none(),
      "Gives pairs a law of restitution (0 Poisson, 1 Newton, 2 energetic), whether an impact of one point is "
      "followed through its impulse, whether e is lowered so that no energy is made, tangential restitution; e as a "
      "function of the closing speed, friction of that of the slip, adhesion of the time (table, address of a C "
      "function, function, or None); friction of what sticks or None; the geometry (0, 1; -1: none) and the axis "
      "along which and across which friction has its shares; radii [m] of the friction against spinning and rolling; "
      "the numbers of the adhesion of its bodies (add_body_pull); e by the closing speed, the slip before and "
      "the time, friction by the slip, the normal force and the time (numbers of functions of three numbers that "
      "add_contact_function returned, or None).");
  scene.def(
      "add_body_pull", [](Scene& s, const Given& pull) { s.body_pulls.push_back(number_function(s, pull)); }, "pull"_a,
      "Adds the adhesion of a body [N] by the time (table, address of a C function, function), which all points share "
      "that touch it.");
  scene.def("set_surface", &set_surface, "geometry"_a, "function"_a, "is_height"_a, "reach"_a, "lost"_a,
            "Makes a halfspace a surface given by a function (address of a C function of one point, or function of "
            "arrays): a height, (n, 2) -> rows of f, f_x, f_y, f_xx, f_xy, f_yy, or a distance, (n, 3) -> rows of d, "
            "d_x, d_y, d_z. reach: the largest distance [m] of one of its points from the origin of a moving body; "
            "lost: called with a point (3,) of which no nearest point "
            "is known, raises.");
  scene.def(
      "set_height_field", &set_height_field, "geometry"_a, "coefficients"_a, "corner"_a, "spacing"_a, "reach"_a,
      "lost"_a,
      "Makes a halfspace a block under a bicubic spline, given by its B-spline coefficients (nx + 2, ny + 2) over "
      "nx * ny places from corner on.");
  scene.def(
      "set_torus",
      [](Scene& s, int geometry, double ring, double tube, const Cells& cells, double reach, const OfPoint& tell) {
        put_level_set(s, geometry, torus(ring, tube), cells, reach, tell);
      },
      "geometry"_a, "ring"_a, "tube"_a, "cells"_a, "reach"_a, "lost"_a, "Makes a halfspace a torus about z.");
  scene.def(
      "set_superellipsoid",
      [](Scene& s, int geometry, const Corner& radii, double exponent, const Cells& cells, double reach,
         const OfPoint& tell) { put_level_set(s, geometry, superellipsoid(radii, exponent), cells, reach, tell); },
      "geometry"_a, "radii"_a, "exponent"_a, "cells"_a, "reach"_a, "lost"_a, "Makes a halfspace a superellipsoid.");
  scene.def(
      "set_thread",
      [](Scene& s, int geometry, double radius, double depth, double pitch, const Cells& cells, double reach,
         const OfPoint& tell) { put_level_set(s, geometry, thread(radius, depth, pitch), cells, reach, tell); },
      "geometry"_a, "radius"_a, "depth"_a, "pitch"_a, "cells"_a, "reach"_a, "lost"_a,
      "Makes a halfspace a thread about z.");
  scene.def("set_spline_solid", &set_spline_solid, "geometry"_a, "coefficients"_a, "cells"_a, "reach"_a, "lost"_a,
            "Makes a halfspace the solid in which a tricubic spline is negative, given by its B-spline coefficients, "
            "three more along each axis than cells, the last axis fastest.");
  scene.def("feet", &feet_of, "geometry"_a, "point"_a, "reach"_a,
            "Rows (n, 4) of distance [m] and outward normal: the nearest foot of a point (3,) on a surface, and those "
            "nearer than reach, in the frame of the surface.");
  scene.def(
      "common_normals", &common_normals_of, "first"_a, "second"_a, "R"_a, "t"_a, "reach"_a,
      "Rows (n, 10) of gap [m], outward normal of the first solid, place on the first and on the second one, each "
      "in its own frame: the least common normal, and those with a gap up to reach; the second frame is at R x + "
      "t in the first one.");
  scene.def(
      "set_surface_motion", &set_surface_motion, "geometry"_a, "linear"_a, "angular"_a, "profile"_a.none(),
      "Lets the surface of a geometry move along itself: linear and angular velocity in its frame, and a factor by "
      "the time (table, address of a C function, function) or None.");
  m.def(
      "follow_impact",
      [](const Mat3& G, const Vec3& w, double mu, double e, int law) {
        const IncrementalImpact impact = follow_impact(G, w, mu, e, static_cast<RestitutionLaw>(law));
        return std::tuple<bool, Vec3, Vec3>(impact.ok, impact.lambda, impact.compression);
      },
      "G"_a, "w"_a, "mu"_a, "e"_a, "law"_a,
      "Impulse (n, t1, t2) of one point by the incremental law, and that until the end of the compression: (ok, (3,), "
      "(3,)).");
}

}  // namespace contactvi

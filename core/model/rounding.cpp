// Two sharp polytopes nearer than about 1e-6 m get wrong normals from GJK and EPA (measured: 83 % of random box
// pairs); swept ones never reach EPA, because their cores stay 2 r apart when the surfaces touch.
#include "model/rounding.hpp"

#include <coal/shape/convex.h>
#include <coal/shape/geometric_shapes.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <unordered_map>

#include "base/error.hpp"
#include "base/refusal.hpp"
#include "base/worker_threads.hpp"
#include "model/convex_hull.hpp"
#include "model/hull_access.hpp"
#include "model/polytope_shape.hpp"
#include "model/scene.hpp"

namespace contactvi {

namespace {

using Hull = coal::Convex<coal::Triangle>;

// Radius by which shapes of GJK pairs are rounded [m]; thinner shapes take less. Between cores that are 2e-6 m apart
// the rounding of 1e-16 m turns normals by 5e-11 rad, but not those of features (geometry/nearest_features.hpp).
constexpr double kRoundingRadius = 1e-6;
// Of the radii of curvature of an ellipsoid, and [m]: how deep below its surface its core lies, which has the same
// normals. Distances are found to rounding for overlaps up to there.
constexpr double kInsetOfCurvature = 0.2, kMostInset = 1e-3;
// Height over length of a triangle of the dual hull below which the plane of its whole face is taken: of a slender one
// the digits are lost.
constexpr double kSlender = 1e-3;
constexpr double kSame = 1e-10;  // of the size: vertices of a shrunk polytope that are nearer to each other are one
constexpr double kSliver =
    1e-18;  // [m^2] twice the area below which a triangle has no normal (of the dual hull [1/m^2])

void push(std::vector<double>& points, const Vec3& p) { points.insert(points.end(), p.data(), p.data() + 3); }

double size_of(const Polytope& hull) {
  return (hull.vertices.colwise().maxCoeff() - hull.vertices.colwise().minCoeff()).norm();
}

double shortest_edge(const Polytope& hull) {
  double shortest = std::numeric_limits<double>::infinity();
  for (Eigen::Index i = 0; i < hull.faces.rows(); ++i)
    for (int k = 0; k < 3; ++k)
      shortest = std::min(shortest,
                          (hull.vertices.row(hull.faces(i, k)) - hull.vertices.row(hull.faces(i, (k + 1) % 3))).norm());
  return shortest;
}

// The points without those that are within `near` of another one that stays.
std::vector<double> apart(const std::vector<double>& points, double near) {
  std::vector<Vec3> all;
  for (std::size_t i = 0; i < points.size(); i += 3) all.emplace_back(points[i], points[i + 1], points[i + 2]);
  std::stable_sort(all.begin(), all.end(), [](const Vec3& a, const Vec3& b) { return a[0] < b[0]; });
  std::vector<Vec3> kept;
  for (const Vec3& p : all) {
    bool is_new = true;
    for (std::size_t k = kept.size(); is_new && k > 0 && p[0] - kept[k - 1][0] <= near; --k)
      is_new = (p - kept[k - 1]).norm() > near;
    if (is_new) kept.push_back(p);
  }
  std::vector<double> result;
  for (const Vec3& p : kept) push(result, p);
  return result;
}

// A shrunk polytope is the intersection of its faces' halfspaces moved in by r. Vertices by duality about the centre
// c: the plane n.(x - c) = d is the point n/d, and every facet of the hull of those points is a vertex of the
// polytope.
std::shared_ptr<coal::CollisionGeometry> shrunk_hull(const Hull& hull, double& radius) {
  const std::vector<coal::Vec3s>& points = *hull.points;
  const std::vector<coal::Triangle>& faces = *hull.polygons;
  const unsigned count = vertex_count(hull);
  coal::Vec3s center = coal::Vec3s::Zero();
  for (unsigned i = 0; i < count; ++i) center += points[i] / count;
  std::vector<coal::Vec3s> normals;
  std::vector<double> offsets;
  double thinnest = INFINITY;
  for (unsigned i = 0; i < hull.num_polygons; ++i) {
    const coal::Vec3s a = points[faces[i][0]], b = points[faces[i][1]], c = points[faces[i][2]];
    coal::Vec3s n = (b - a).cross(c - a);
    if (n.norm() < kSliver) continue;  // its neighbours have the same plane
    n.normalize();
    double d = n.dot(a - center);
    if (d < 0) {
      n = -n;
      d = -d;
    }
    normals.push_back(n);
    offsets.push_back(d);
    thinnest = std::min(thinnest, d);
  }
  radius = std::min(radius, 0.2 * thinnest);
  std::vector<double> dual;
  for (std::size_t i = 0; i < normals.size(); ++i) push(dual, normals[i] / (offsets[i] - radius));
  Planes planes;
  const Polytope dual_hull = hull_of(dual.data(), dual.size() / 3, planes);
  std::vector<double> vertices;
  for (Eigen::Index i = 0; i < dual_hull.faces.rows(); ++i) {
    const Vec3 a = dual_hull.vertices.row(dual_hull.faces(i, 0)), b = dual_hull.vertices.row(dual_hull.faces(i, 1)),
               c = dual_hull.vertices.row(dual_hull.faces(i, 2));
    Vec3 n = (b - a).cross(c - a);
    double d = n.dot(a);
    const double longest = std::max({(b - a).norm(), (c - a).norm(), (c - b).norm()});
    if (n.norm() < kSlender * longest * longest) {
      n = planes.row(i).head<3>();
      d = planes(i, 3);
    }
    if (n.norm() < kSliver || std::abs(d) < 1e-12 * n.norm()) continue;
    push(vertices, center + n / d);
  }
  Polytope shrunk = hull_of(vertices.data(), vertices.size() / 3);
  // Coal's search for the farthest vertex stops at one of several that are nearer to each other than it can tell apart.
  const double near = shrunk.faces.rows() > 0 ? kSame * size_of(shrunk) : 0.0;
  if (shortest_edge(shrunk) < near) {
    vertices = apart(vertices, near);
    shrunk = hull_of(vertices.data(), vertices.size() / 3);
  }
  return shrunk.faces.rows() > 0 ? shape_of(shrunk) : nullptr;
}

// A sharp shape, and its rounded copy as it is made.
struct Rounding {
  const coal::CollisionGeometry* sharp;
  std::string name;  // of a geometry that has it
  std::optional<ShrunkHull> found;
  std::shared_ptr<coal::CollisionGeometry> core;
  double radius;

  const Hull* hull() const { return dynamic_cast<const Hull*>(sharp); }

  void make() {
    radius = found ? found->radius : kRoundingRadius;
    core = found ? shape_of(found->hull) : shrunk_shape(*sharp, radius);
    if (!core)
      throw Refusal("The hull of geometry '" + name + "' cannot be rounded at its edges", "a hull with a volume",
                    "a flat or very thin one", "Make the mesh thicker, or replace it by a box");
    static_cast<coal::ShapeBase&>(*core).setSweptSphereRadius(radius);
    core->computeLocalAABB();
  }
};

}  // namespace

void round_shapes(const std::vector<Geometry*>& geometries, const std::vector<std::string>& names,
                  RoundedHulls* known) {
  std::vector<Rounding> roundings;
  std::vector<std::size_t> number;  // of each geometry's rounding
  std::unordered_map<const coal::CollisionGeometry*, std::size_t> numbers;
  for (std::size_t k = 0; k < geometries.size(); ++k) {
    const coal::CollisionGeometry* sharp = geometries[k]->sharp.get();
    const auto [at, is_new] = numbers.emplace(sharp, roundings.size());
    if (is_new) roundings.push_back({sharp, names[k], std::nullopt, nullptr, 0.0});
    number.push_back(at->second);
  }
  if (known)
    for (Rounding& r : roundings)
      if (const Hull* hull = r.hull()) r.found = known->find(polytope_of(*hull), kRoundingRadius);
  in_parallel(static_cast<int>(roundings.size()), [&](int k) { roundings[k].make(); });
  for (std::size_t k = 0; k < geometries.size(); ++k) {
    geometries[k]->rounded = roundings[number[k]].core;
    // An ellipsoid has no edges.
    geometries[k]->rounding =
        roundings[number[k]].sharp->getNodeType() == coal::GEOM_ELLIPSOID ? 0.0 : roundings[number[k]].radius;
  }
  if (!known) return;
  for (const Rounding& r : roundings) {
    const auto *hull = r.hull(), *core = dynamic_cast<const Hull*>(r.core.get());
    if (!r.found && hull && core) known->keep(polytope_of(*hull), kRoundingRadius, {polytope_of(*core), r.radius});
  }
}

std::shared_ptr<coal::CollisionGeometry> shrunk_shape(const coal::CollisionGeometry& shape, double& radius) {
  if (const auto* box = dynamic_cast<const coal::Box*>(&shape)) {
    radius = std::min(radius, 0.2 * box->halfSide.minCoeff());
    return std::make_shared<coal::Box>(2 * (box->halfSide - coal::Vec3s::Constant(radius)));
  }
  if (const auto* cylinder = dynamic_cast<const coal::Cylinder*>(&shape)) {
    radius = std::min({radius, 0.2 * cylinder->radius, 0.2 * cylinder->halfLength});
    return std::make_shared<coal::Cylinder>(cylinder->radius - radius, 2 * (cylinder->halfLength - radius));
  }
  if (const auto* ellipsoid = dynamic_cast<const coal::Ellipsoid*>(&shape)) {
    // The parallel surface of an ellipsoid is none: this one has its half axes, holds it, and is within r of it. Coal
    // searches there; the features are those of the parallel surface (geometry/ellipsoid.hpp).
    const double thin = ellipsoid->radii.minCoeff();
    radius = std::min(kMostInset, kInsetOfCurvature * thin * thin / ellipsoid->radii.maxCoeff());
    return std::make_shared<coal::Ellipsoid>(coal::Vec3s(ellipsoid->radii - coal::Vec3s::Constant(radius)));
  }
  if (const auto* hull = dynamic_cast<const Hull*>(&shape)) return shrunk_hull(*hull, radius);
  return nullptr;
}

}  // namespace contactvi

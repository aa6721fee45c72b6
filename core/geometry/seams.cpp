#include "geometry/seams.hpp"

#include <coal/collision_object.h>

#include <algorithm>
#include <map>
#include <utility>

#include "geometry/candidates.hpp"
#include "geometry/contact_features.hpp"
#include "geometry/shape_features.hpp"
#include "model/box_tree.hpp"

namespace contactvi {

namespace {

// [m] A shape holds points that are no farther outside of it, besides what edges are rounded by: the rounding of places
// of some metres, and what is promised of gaps.
constexpr double kFlushShapes = 1e-9;
// [m] What a neighbour has to reach beyond a place at least: the rounding of a place.
constexpr double kBeyondPlace = 1e-14;
// [m] So far beyond an edge a neighbour has to go on; more than edges are rounded by.
constexpr double kGoesOn = 1e-5;

bool has_flat_sides(const Geometry& g) {
  const coal::NODE_TYPE type = g.sharp->getNodeType();
  return type == coal::GEOM_BOX || type == coal::GEOM_CONVEX || type == coal::GEOM_CYLINDER;
}

// Whether the shape, swept by its radius and by `more` besides, holds a point of its body's frame, seen along the
// normals of its faces.
bool holds(const ShapeFeatures& o, const Vec3& x, double more) {
  const double far = o.radius + more;
  for (const ShapeFeatures::Face& f : o.faces)
    if (f.normal.dot(x) - f.offset > far) return false;
  if (o.rims.empty()) return true;
  const ShapeFeatures::Edge& axis = o.edges[0];
  return (x - axis.start).cross(axis.direction).norm() <= axis.radius + far;
}

double reach_along(const ShapeFeatures& o, const Vec3& m) {
  if (o.rims.empty()) return m.dot(o.vertices[farthest_vertex(o, m)]) + o.radius;
  const ShapeFeatures::Rim& rim = m.dot(o.rims[0].axis) >= 0.0 ? o.rims[0] : o.rims[1];
  return m.dot(lowest_of_rim(rim.center, rim.axis, rim.radius, -m)) + o.radius;
}

}  // namespace

Seams::Seams(const Scene& scene) : scene_(&scene), pairs_(scene.pairs, scene.geometries.size()) {
  std::vector<bool> tested(scene.geometries.size(), false);
  for (const Pair& pair : scene.pairs) tested[pair.a] = tested[pair.b] = true;
  std::map<int, std::vector<int>> of_body;
  for (int g = 0; g < static_cast<int>(scene.geometries.size()); ++g)
    if (tested[g] && has_flat_sides(scene.geometries[g])) of_body[scene.geometries[g].body].push_back(g);
  std::vector<std::pair<int, int>> found;
  for (const auto& [body, shapes] : of_body) {
    if (shapes.size() < 2) continue;
    std::vector<BoxTree::Box> boxes;
    for (int g : shapes) {
      const Geometry& geometry = scene.geometries[g];
      const Vec3 center = geometry.R_BG * geometry.box_center + geometry.p_BG,
                 half = geometry.R_BG.cwiseAbs() * geometry.box_half;
      boxes.emplace_back(center - half, center + half);
    }
    const BoxTree tree(boxes);
    tree.near_pairs(
        tree, Mat3::Identity(), Vec3::Zero(), kFlushShapes, [](std::size_t, std::size_t) { return true; },
        [&, &shapes = shapes](int i, int j) {
          if (i != j) found.emplace_back(shapes[i], shapes[j]);
          return kFlushShapes;
        });
  }
  std::sort(found.begin(), found.end());
  start_.assign(scene.geometries.size() + 1, 0);
  for (const auto& [g, other] : found) {
    ++start_[g + 1];
    near_.push_back(other);
  }
  for (std::size_t g = 0; g < scene.geometries.size(); ++g) start_[g + 1] += start_[g];
}

double Seams::slack(int pair, const Placements& at, const Contact& contact) const {
  const Pair& p = scene_->pairs[pair];
  return std::max(beyond(p.b, p.a, at, contact.point_a, contact.normal),
                  beyond(p.a, p.b, at, contact.point_b, -contact.normal));
}

// How far neighbours of a geometry that hold its point x, and that the other shape is tested against, too, reach beyond
// x along its outward normal m.
double Seams::beyond(int other, int geometry, const Placements& at, const Vec3& x_W, const Vec3& m_W) const {
  double most = 0.0;
  if (!has_any(geometry)) return most;
  const Pose body = pose_of(scene_->geometries[geometry].body, at);
  const Vec3 x = body.into(x_W), m = body.R.transpose() * m_W;
  for (int k = start_[geometry]; k < start_[geometry + 1]; ++k) {
    const Geometry& neighbor = scene_->geometries[near_[k]];
    pairs_.each(other, near_[k], [&](int guard) {
      const bool rounded = scene_->pairs[guard].rounded;
      const ShapeFeatures& o = shape_features_of(neighbor, rounded);
      // The nearest point of a rounded edge lies inside of the sharp one.
      if (!holds(o, x, kFlushShapes + (rounded ? scene_->geometries[geometry].rounding : 0.0))) return;
      const double beyond = reach_along(o, m) - m.dot(x);
      if (beyond > kBeyondPlace) most = std::max(most, std::min(beyond, kFeatureRounding));
    });
  }
  return most;
}

bool Seams::goes_on(int pair, const Placements& at, const Vec3& x_W, const Vec3& n_W, const Vec3& u_a,
                    const Vec3& u_b) const {
  const Pair& p = scene_->pairs[pair];
  return goes_on_over(p.b, p.a, p.rounded, at, x_W, n_W, u_b) || goes_on_over(p.a, p.b, p.rounded, at, x_W, -n_W, u_a);
}

// Whether an edge of `other` that crosses one of the geometry in x, where the outward normal is m, goes on along u over
// a flush neighbour of the geometry.
bool Seams::goes_on_over(int other, int geometry, bool rounded, const Placements& at, const Vec3& x_W, const Vec3& m_W,
                         const Vec3& u_W) const {
  if (!has_any(geometry)) return false;
  const Geometry& own = scene_->geometries[geometry];
  const Pose body = pose_of(own.body, at);
  const Vec3 x = body.into(x_W), m = body.R.transpose() * m_W, step = kGoesOn * (body.R.transpose() * u_W);
  const ShapeFeatures& shape = shape_features_of(own, rounded);
  const double far = kFlushShapes + (rounded ? own.rounding : 0.0);
  if (!holds(shape, x, far)) return false;
  bool found = false;
  for (const Vec3& y : {Vec3(x + step), Vec3(x - step)}) {
    if (holds(shape, y, far)) continue;
    for (int k = start_[geometry]; k < start_[geometry + 1] && !found; ++k)
      pairs_.each(other, near_[k], [&](int guard) {
        const ShapeFeatures& o = shape_features_of(scene_->geometries[near_[k]], scene_->pairs[guard].rounded);
        found = found || (holds(o, y, far) && holds(o, x, far) && reach_along(o, m) - m.dot(x) <= kFlushShapes);
      });
  }
  return found;
}

}  // namespace contactvi

// Manifolds: the points at which shapes touch a surface that a function gives, and the feet of points on it.
#include <algorithm>
#include <cmath>

#include "geometry/manifold.hpp"
#include "geometry/solid_pair.hpp"
#include "geometry/surface_frame.hpp"

namespace contactvi {

namespace {

// Of the distance, and [m]: feet that are no farther from each other are one.
constexpr double kSameFoot = 1e-5, kSameFootLength = 1e-9;

}  // namespace

const Geometry* Manifolds::surface_of(int pair) const {
  const Pair& p = scene_->pairs[pair];
  const Geometry &a = scene_->geometries[p.a], &b = scene_->geometries[p.b];
  return a.surface ? &a : b.surface ? &b : nullptr;
}

// All vertices of the other shape. A gap that is no number is listed whatever the limit is.
void Manifolds::list_on_surface(int pair, const PairView& v, const Placements& at, CandidateSink& sink) {
  if (has_common_normals(pair)) return list_common_normals(pair, at, sink);
  if (has_feet(pair)) return list_feet(pair, v, at, sink);
  const Geometry& g = *surface_of(pair);
  const bool on_b = &g == &scene_->geometries[scene_->pairs[pair].a];
  const ShapeFeatures& o = on_b ? *v.b : *v.a;
  const Pose &own = on_b ? v.pose_b : v.pose_a, surface = pose_of_surface(g, at);
  over_surface_.clear();
  for (const Vec3& x : o.vertices) over_surface_.push_back(surface.into(own.point(x)));
  const int count = static_cast<int>(over_surface_.size());
  feet_.resize(over_surface_.size());
  g.surface->nearest(over_surface_.data(), count, o.radius, feet_.data());
  for (int i = 0; i < count; ++i) {
    const double gap = feet_[i].distance - o.radius;
    if (gap > sink.limit) continue;
    const Vec3 x = over_surface_[i] - o.radius * feet_[i].normal;
    sink.add({feature_number(on_b ? Feature::kVertexB : Feature::kVertexA, i, 0), gap, surface.point(x)});
  }
}

// All feet of all vertices that are nearer than twice the radius, and the nearest one of each vertex.
void Manifolds::list_feet(int pair, const PairView& v, const Placements& at, CandidateSink& sink) {
  const Geometry& g = *surface_of(pair);
  const bool on_b = &g == &scene_->geometries[scene_->pairs[pair].a];
  const ShapeFeatures& o = on_b ? *v.b : *v.a;
  const Pose &own = on_b ? v.pose_b : v.pose_a, surface = pose_of_surface(g, at);
  const double reach = o.radius + std::clamp(sink.limit, 0.0, o.radius);
  feet_.clear();
  std::vector<SurfaceFoot> feet;
  std::vector<int> numbers;
  for (int i = 0; i < static_cast<int>(o.vertices.size()); ++i) {
    const Vec3 x = surface.into(own.point(o.vertices[i]));
    g.surface->all_feet(x, reach, feet);
    numbers.clear();
    for (const SurfaceFoot& foot : feet) numbers.push_back(number_of_foot(*g.surface, pair, i, x, foot.of(x)));
    int free = 0;
    for (std::size_t k = 0; k < feet.size(); ++k) {
      while (numbers[k] < 0 && std::find(numbers.begin(), numbers.end(), free) != numbers.end()) ++free;
      if (numbers[k] < 0) numbers[k] = free;
      feet_.push_back(feet[k]);
      const double gap = feet[k].distance - o.radius;
      if (gap > sink.limit) continue;
      sink.add({feature_number(on_b ? Feature::kVertexB : Feature::kVertexA, i, numbers[k]), gap,
                surface.point(feet[k].of(x))});
    }
  }
}

// Of the foot of a vertex that belongs to a persistent point; -1: to none.
int Manifolds::number_of_foot(const FunctionSurface& surface, int pair, int vertex, const Vec3& point,
                              const Vec3& place) const {
  for (const KnownFoot& known : known_feet_) {
    if (known.pair != pair || feature_i(known.feature) != vertex) continue;
    const SurfaceFoot foot = surface.foot_near(point, known.place);
    if ((foot.of(point) - place).norm() <= kSameFoot * foot.distance + kSameFootLength) return feature_j(known.feature);
  }
  return -1;
}

bool Manifolds::has_feet(int pair) const {
  const Geometry* g = any_feet_ ? surface_of(pair) : nullptr;
  if (g == nullptr || !g->surface->knows_all_feet()) return false;
  if (has_common_normals(pair)) return true;
  const Pair& p = scene_->pairs[pair];
  return features(pair, g == &scene_->geometries[p.a] ? p.b : p.a).radius > 0.0;
}

void Manifolds::set_persistent(int pair, const std::vector<const ContactPoint*>& points) {
  if (!has_feet(pair)) return;
  known_feet_.erase(std::remove_if(known_feet_.begin(), known_feet_.end(),
                                   [pair](const KnownFoot& known) { return known.pair == pair; }),
                    known_feet_.end());
  if (has_common_normals(pair)) {
    const Pair& own = scene_->pairs[pair];
    for (const ContactPoint* p : points) {
      const Geometry &second = scene_->geometries[p->on_b ? own.b : own.a],
                     &first = scene_->geometries[p->on_b ? own.a : own.b];
      known_feet_.push_back({pair, p->feature, in_surface(first, p->origin_B), in_surface(second, p->center_B)});
    }
    return;
  }
  const Geometry& g = *surface_of(pair);
  for (const ContactPoint* p : points) known_feet_.push_back({pair, p->feature, in_surface(g, p->far_B), Vec3::Zero()});
}

void Manifolds::surface_gap(const ContactPoint& p, const Placements& at, Contact& contact) const {
  const Geometry& g = *surface_of(p.guard);
  const Pose surface = pose_of_surface(g, at);
  const Vec3 c = pose_of(p.point_body, at).point(p.center_B), x = surface.into(c);
  SurfaceFoot foot{};
  if (g.surface->knows_all_feet() && p.radius > 0.0)
    foot = g.surface->foot_near(x, in_surface(g, p.far_B));
  else
    g.surface->nearest(&x, 1, p.radius, &foot);
  set_contact(p, surface.R * foot.normal, c, foot.distance - p.radius, contact);
}

}  // namespace contactvi

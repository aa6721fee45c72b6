#include "geometry/solid_pair.hpp"

#include "model/implicit_surface.hpp"

namespace contactvi {

namespace {

bool is_halfspace(const Geometry& g) { return g.unbounded && !g.surface; }

CommonNormals normals_between(const Geometry& first, const Geometry& second, const Pose& one, const Pose& other) {
  return {{first.solid.get(), first.halfspace_normal, first.halfspace_offset},
          *second.solid,
          one.R.transpose() * other.R,
          one.into(other.p)};
}

}  // namespace

bool SolidPair::is_one(const Scene& scene, int pair) {
  const Geometry &a = scene.geometries[scene.pairs[pair].a], &b = scene.geometries[scene.pairs[pair].b];
  if (!(a.surface && a.solid) && !(b.surface && b.solid)) return false;
  return (a.solid || is_halfspace(a)) && (b.solid || is_halfspace(b));
}

SolidPair::SolidPair(const Scene& scene, int pair, const Placements& at)
    : second_is_b_(scene.geometries[scene.pairs[pair].b].solid != nullptr),
      first_(&scene.geometries[second_is_b_ ? scene.pairs[pair].a : scene.pairs[pair].b]),
      second_(&scene.geometries[second_is_b_ ? scene.pairs[pair].b : scene.pairs[pair].a]),
      first_pose_(pose_of_surface(*first_, at)),
      second_pose_(pose_of_surface(*second_, at)),
      normals_(normals_between(*first_, *second_, first_pose_, second_pose_)) {}

}  // namespace contactvi

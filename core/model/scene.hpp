// What never changes during a run: the tree, the collision geometries, the pairs that may touch, and their laws.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "base/on_demand.hpp"
#include "model/polytope.hpp"
#include "model/tree.hpp"

namespace coal {
class CollisionGeometry;
}

namespace contactvi {

struct ShapeFeatures;
class PairTable;
class RoundedHulls;

struct Geometry {
  int body;   // engine joint that moves it, -1: world
  Mat3 R_BG;  // geometry frame in the body frame
  Vec3 p_BG;
  std::shared_ptr<const coal::CollisionGeometry> sharp;
  // The same size, with edges of radius rounding [m]; null if not needed.
  std::shared_ptr<const coal::CollisionGeometry> rounded;
  double rounding;
  bool unbounded;         // a halfspace, with the normal and offset that follow
  Vec3 halfspace_normal;  // geometry frame
  double halfspace_offset;
  Vec3 center_B;  // bounding sphere, body frame
  double radius;
  double reach;  // largest distance of one of its points from the body origin
  // Bounding box along the axes of the geometry's frame [m]; a ball has the same box whichever way it is turned.
  Vec3 box_center, box_half;
  bool is_ball;
  // Features of the sharp and of the rounded shape, shared by all that simulate the scene and made when a pair first
  // comes near enough to need them; null where no pair ever does.
  std::shared_ptr<const OnDemand<ShapeFeatures>> sharp_features, rounded_features;
};

struct Pair {
  int a, b;  // geometry indices
  double restitution;
  double friction;  // Coulomb's coefficient
  bool rounded;     // both shapes are taken rounded: near contact GJK and EPA give wrong normals on sharp ones
  bool refined;     // GJK iterates towards a cylinder or an ellipsoid: the distance is found to rounding from there
};

struct Scene {
  Tree tree;
  std::vector<Geometry> geometries;
  std::vector<Pair> pairs;
  std::shared_ptr<const PairTable> pair_table;  // of the pairs, made by prepare_geometry

  int guard_count() const { return static_cast<int>(pairs.size() + tree.limits.size()); }
  bool is_pair(int guard) const { return guard < static_cast<int>(pairs.size()); }
  double friction(int guard) const { return is_pair(guard) ? pairs[guard].friction : 0.0; }
  double restitution(int guard) const {
    return is_pair(guard) ? pairs[guard].restitution : tree.limits[guard - pairs.size()].restitution;
  }
};

// Data of joints and pairs that Pinocchio's archives do not carry; indices are the public model's.
struct SceneParameters {
  VecX pair_restitution;   // npairs
  VecX pair_friction;      // npairs
  VecX stiffness;          // njoints
  VecX rest;               // nq
  VecX damping;            // nv
  VecX limits;             // njoints, nonzero: the joint's position limits are guards
  VecX limit_restitution;  // njoints
};

// Numbers of two geometries in each row.
using GeometryPairs = Eigen::Matrix<int, Eigen::Dynamic, 2, Eigen::RowMajor>;

// A hull that several geometries may have in the place of their shapes in the archive.
struct GivenHull {
  std::vector<int> geometries;
  Polytope hull;
  double swept_radius;  // [m]
};

// What crosses beside the archive of a geometry model: archives of many pairs are large, and hulls are read slowly.
struct BesideArchive {
  std::optional<GeometryPairs> pairs;  // none: those of the archive
  std::vector<GivenHull> hulls;
};

// The scene of the binary archives of a pin.Model and a pin.GeometryModel. Throws Error for joints, shapes or orders
// that the engine does not support. Of `known`, which may be null, come rounded hulls that were made before; it is
// handed those that are made now.
Scene load_scene(std::string_view model, std::string_view geometry, const BesideArchive& beside,
                 const SceneParameters& parameters, RoundedHulls* known);

}  // namespace contactvi

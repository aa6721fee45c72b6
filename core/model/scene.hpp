// What never changes during a run: the tree, the collision geometries, the pairs that may touch, and their laws.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "base/on_demand.hpp"
#include "model/contact_law.hpp"
#include "model/surface_motion.hpp"
#include "model/tree.hpp"

namespace coal {
class CollisionGeometry;
}

namespace contactvi {

struct PublicModel;
struct ShapeFeatures;
class FunctionSurface;
class HeightField;
class ImplicitSurface;
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
  bool unbounded;         // a halfspace, with the normal and offset that follow, or a surface given by a function
  Vec3 halfspace_normal;  // geometry frame
  double halfspace_offset;
  Vec3 center_B;  // bounding sphere, body frame
  double radius;
  double reach;  // largest distance of one of its points from the body origin
  // Bounding box along the axes of the geometry's frame [m]; a ball has the same box whichever way it is turned.
  Vec3 box_center, box_half;
  bool is_ball;
  int motion = -1;  // of its surface, in Scene::surface_motions; -1: none
  // Features of the sharp and of the rounded shape, shared by all that simulate the scene and made when a pair first
  // comes near enough to need them; null where no pair ever does.
  std::shared_ptr<const OnDemand<ShapeFeatures>> sharp_features, rounded_features;
  // In the geometry's frame, in the place of a halfspace; null: none.
  std::shared_ptr<const FunctionSurface> surface;
  // Its surface as a level set: of such a surface, and of an ellipsoid that meets one or a field; null: none.
  std::shared_ptr<const ImplicitSurface> solid;
  // As a smooth height field; null: it is none.
  std::shared_ptr<const HeightField> field;
  // Whether it has a bounding sphere although it stands in the place of a halfspace.
  bool is_bounded() const { return !unbounded || reaches; }
  bool reaches = false;
};

struct Pair {
  int a, b;  // geometry indices
  double restitution;
  double friction;     // Coulomb's coefficient
  bool rounded;        // both shapes are taken rounded: near contact GJK and EPA give wrong normals on sharp ones
  bool refined;        // GJK iterates towards a cylinder or an ellipsoid: the distance is found to rounding from there
  int law = -1;        // in Scene::laws; -1: none beyond the two coefficients
  bool moves = false;  // a surface of it moves along itself
};

struct Scene {
  std::shared_ptr<const PublicModel> model;  // what it was made of
  Tree tree;
  std::vector<Geometry> geometries;
  std::vector<Pair> pairs;
  std::vector<ContactLaw> laws;                 // of the pairs that have one
  std::vector<SurfaceMotion> surface_motions;   // of the geometries that have one
  std::vector<NumberFunction> body_pulls;       // adhesion of bodies by the time [N], shared by all points of a body
  std::shared_ptr<const PairTable> pair_table;  // of the pairs, made by prepare_geometry

  int guard_count() const { return static_cast<int>(pairs.size() + tree.limits.size()); }
  bool is_pair(int guard) const { return guard < static_cast<int>(pairs.size()); }
  // Whether a shape of a pair has a surface that is given by a function.
  bool has_surface(int guard) const {
    return is_pair(guard) && (geometries[pairs[guard].a].surface || geometries[pairs[guard].b].surface);
  }
  // What a guard has beyond two coefficients, null: nothing.
  const ContactLaw* law(int guard) const {
    return is_pair(guard) && pairs[guard].law >= 0 ? &laws[pairs[guard].law] : nullptr;
  }
  double friction(int guard) const { return is_pair(guard) ? pairs[guard].friction : 0.0; }
  // Coefficients of what slides with this speed [m/s], and of what sticks, by laws that depend on nothing else
  // (friction_state.hpp has the other ones).
  double sliding_friction(int guard, double speed) const {
    const ContactLaw* own = law(guard);
    return own != nullptr && own->mu.given() ? own->mu(speed) : friction(guard);
  }
  double static_friction(int guard) const {
    const ContactLaw* own = law(guard);
    return own != nullptr && own->static_mu >= 0.0 ? own->static_mu : sliding_friction(guard, 0.0);
  }
  // Whether friction is not one number.
  bool friction_varies(int guard) const {
    const ContactLaw* own = law(guard);
    return own != nullptr && (own->mu.given() || own->static_mu >= 0.0 || own->mu_of_state != nullptr);
  }
  // Whether it depends on the normal force and the time.
  bool friction_by_state(int guard) const {
    const ContactLaw* own = law(guard);
    return own != nullptr && own->mu_of_state != nullptr;
  }
  // Whether a surface of some pair moves along itself, or adhesion or friction may depend on the time.
  bool contacts_depend_on_time() const {
    for (const Pair& pair : pairs)
      if (pair.moves || (pair.law >= 0 && (laws[pair.law].adheres() || laws[pair.law].mu_of_state != nullptr)))
        return true;
    return false;
  }
  // Rows of a point: the normal one, with friction those of slip, spinning and rolling.
  int contact_rows(int guard) const {
    if (!(friction(guard) > 0.0)) return 1;
    const ContactLaw* own = law(guard);
    return own != nullptr ? 3 + own->turning_rows() : 3;
  }
  double restitution(int guard) const {
    return is_pair(guard) ? pairs[guard].restitution : tree.limits[guard - pairs.size()].restitution;
  }
};

// Data of joints and pairs besides those of the model and the shapes; indices are the public model's.
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

// A shape on a joint of the public model, whose owner keeps it.
struct GivenShape {
  int joint;  // 0: the world
  Mat3 R_JG;
  Vec3 p_JG;
  std::string name;
  const coal::CollisionGeometry* shape;
};

// The scene of a model, of shapes, which are copied, and of the pairs of these that may touch. Throws Error for sizes
// that do not fit each other, Refusal for joints, shapes or pairs that the engine does not support. Of `known`, which
// may be null, come rounded hulls that were made before; it is handed those that are made now.
Scene load_scene(std::shared_ptr<const PublicModel> model, const std::vector<GivenShape>& shapes,
                 const GeometryPairs& pairs, const SceneParameters& parameters, RoundedHulls* known);

}  // namespace contactvi

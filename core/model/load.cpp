// Makes the engine's Scene from a model in public coordinates and coal's shapes.
#include <coal/shape/geometric_shapes.h>

#include <cmath>
#include <map>
#include <utility>

#include "base/refusal.hpp"
#include "model/crowded_vertex.hpp"
#include "model/hull_access.hpp"
#include "model/polytope_shape.hpp"
#include "model/public_model.hpp"
#include "model/rounding.hpp"
#include "model/scene.hpp"

namespace contactvi {

namespace {

// Rotation whose third column is the unit vector axis; exact for coordinate axes.
Mat3 frame_along(const Vec3& axis) {
  Mat3 R;
  Eigen::Index largest;
  axis.cwiseAbs().maxCoeff(&largest);
  const Vec3 helper = Vec3::Unit((largest + 1) % 3);
  R.col(2) = axis;
  R.col(0) = (helper - axis.dot(helper) * axis).normalized();
  R.col(1) = axis.cross(R.col(0));
  return R;
}

class Builder {
 public:
  Builder(const PublicModel& model, const SceneParameters& parameters, Scene& scene)
      : model_(model), parameters_(parameters), tree_(scene.tree) {}

  void build() {
    const int n = static_cast<int>(model_.joints.size());
    tree_.nq = model_.nq;
    tree_.nv = model_.nv;
    tree_.gravity = model_.gravity;
    tree_.armature = model_.armature;
    tree_.damping = parameters_.damping;
    tree_.rest = parameters_.rest;
    tree_.body_of_source.assign(n, -1);
    tree_.R_body_source.assign(n, Mat3::Identity());
    for (int i = 1; i < n; ++i) add(i);
    find_springs_and_damping(tree_);
    number_dofs();
  }

 private:
  // Adds one engine joint whose moving frame is the source joint's frame turned by A.
  void push(int source, JointType type, int parent, const Mat3& R_parent_source, const Vec3& p, const Mat3& A, int iq,
            int nq, int iv, int nv, double pitch, bool last) {
    Joint joint;
    joint.type = type;
    joint.parent = parent;
    joint.iq = iq;
    joint.nq = nq;
    joint.iv = iv;
    joint.nv = nv;
    joint.pitch = pitch;
    joint.R_PJ = R_parent_source * A;
    joint.p_PJ = p;
    joint.mass = 0;
    joint.first_moment.setZero();
    joint.inertia.setZero();
    joint.stiffness = parameters_.stiffness[source];
    joint.name = model_.joints[source].name;
    if (last) {
      const PublicJoint& body = model_.joints[source];
      set_body(joint, body.mass, body.centre, body.inertia, A);
      tree_.body_of_source[source] = static_cast<int>(tree_.joints.size());
      // R_body_source takes coordinates in the public model's joint frame to the engine's body frame.
      tree_.R_body_source[source] = A.transpose();
    }
    tree_.joints.push_back(joint);
  }

  void add(int i) {
    const PublicJoint& source = model_.joints[i];
    const int parent = tree_.body_of_source[source.parent];
    const Mat3& R_parent = tree_.R_body_source[source.parent];
    const Mat3 R = R_parent * source.R_PJ;
    const Vec3 p = R_parent * source.p_PJ;
    const int iq = source.iq, iv = source.iv;
    const Mat3 I = Mat3::Identity();
    const Vec3 zero = Vec3::Zero();
    const int at = static_cast<int>(tree_.joints.size());
    switch (source.type) {
      case PublicJointType::kFreeFlyer:
        split(i);
        push(i, JointType::kTranslation, parent, R, p, I, iq, 3, iv, 3, 0, false);
        push(i, JointType::kSpherical, at, I, zero, I, iq + 3, 4, iv + 3, 3, 0, true);
        return;
      case PublicJointType::kPlanar: {
        split(i);
        const Mat3 X = frame_along(Vec3::UnitX()), Y = frame_along(Vec3::UnitY());
        push(i, JointType::kPrismatic, parent, R, p, X, iq, 1, iv, 1, 0, false);
        push(i, JointType::kPrismatic, at, X.transpose(), zero, Y, iq + 1, 1, iv + 1, 1, 0, false);
        push(i, JointType::kContinuous, at + 1, Y.transpose(), zero, I, iq + 2, 2, iv + 2, 1, 0, true);
        return;
      }
      case PublicJointType::kTranslation:
        push(i, JointType::kTranslation, parent, R, p, I, iq, 3, iv, 3, 0, true);
        return;
      case PublicJointType::kSpherical:
        push(i, JointType::kSpherical, parent, R, p, I, iq, 4, iv, 3, 0, true);
        return;
      case PublicJointType::kRevolute:
        return add_one_dof(i, JointType::kRevolute, parent, R, p);
      case PublicJointType::kContinuous:
        return add_one_dof(i, JointType::kContinuous, parent, R, p);
      case PublicJointType::kPrismatic:
        return add_one_dof(i, JointType::kPrismatic, parent, R, p);
      case PublicJointType::kHelical:
        return add_one_dof(i, JointType::kHelical, parent, R, p);
    }
  }

  // Notes a joint that becomes several.
  void split(int i) {
    const PublicJoint& source = model_.joints[i];
    const bool planar = source.type == PublicJointType::kPlanar;
    if (!model_.armature.segment(source.iv, source.nv).isZero(0) || parameters_.stiffness[i] != 0)
      throw Refusal("Joint '" + source.name + "' has an armature or a spring", "neither of them on this type",
                    planar ? "planar" : "free-flyer",
                    "Take them off with scene.set_joint, or build the joint from revolute and prismatic ones");
    tree_.split.push_back({planar, source.iq, source.iv});
  }

  void add_one_dof(int i, JointType type, int parent, const Mat3& R, const Vec3& p) {
    const PublicJoint& source = model_.joints[i];
    const Vec3 along = source.subspace.head<3>();
    const Vec3 axis = type == JointType::kPrismatic ? along : Vec3(source.subspace.tail<3>());
    const double pitch = type == JointType::kHelical ? along.dot(axis) : 0.0;
    push(i, type, parent, R, p, frame_along(axis), source.iq, source.nq, source.iv, 1, pitch, true);
    if (parameters_.limits[i] != 0) add_limits(i);
  }

  void add_limits(int i) {
    const PublicJoint& source = model_.joints[i];
    const int joint = tree_.body_of_source[i];
    if (source.nq != 1)
      throw Refusal("Joint '" + source.name + "' has limits", "limits on joints with one number in q only",
                    "continuous", "Take them off: scene.set_joint(name, limits=False)");
    const double lower = model_.lower[source.iq], upper = model_.upper[source.iq];
    const double e = parameters_.limit_restitution[i];
    if (std::isfinite(lower)) tree_.limits.push_back({joint, i, false, lower, e});
    if (std::isfinite(upper)) tree_.limits.push_back({joint, i, true, upper, e});
  }

  void number_dofs() {
    tree_.dof_joint.assign(tree_.nv, -1);
    tree_.dof_parent.assign(tree_.nv, -1);
    for (std::size_t k = 0; k < tree_.joints.size(); ++k) {
      const Joint& joint = tree_.joints[k];
      for (int d = 0; d < joint.nv; ++d) {
        const int dof = joint.iv + d;
        tree_.dof_joint[dof] = static_cast<int>(k);
        if (d > 0) {
          tree_.dof_parent[dof] = dof - 1;
        } else if (joint.parent >= 0) {
          const Joint& parent = tree_.joints[joint.parent];
          tree_.dof_parent[dof] = parent.iv + parent.nv - 1;
          if (tree_.dof_parent[dof] >= dof) throw Error("joint " + joint.name + " comes before its parent");
        }
      }
    }
  }

  const PublicModel& model_;
  const SceneParameters& parameters_;
  Tree& tree_;
};

// Whether coal has closed forms for pairs with the shape, or GJK takes it as a point or a segment.
bool needs_no_rounding(coal::NODE_TYPE type) {
  return type == coal::GEOM_HALFSPACE || type == coal::GEOM_SPHERE || type == coal::GEOM_CAPSULE;
}

// Where GJK iterates towards a curved surface. Measured noise of the distance near contact (gjk_tolerance 1e-10): 1e-15
// between polytopes, spheres and capsules, up to 2e-8 with an ellipsoid or a cylinder; smaller tolerances make it
// worse. Such distances are found to rounding from coal's (geometry/nearest_features.hpp, nearest_on_ellipsoid.hpp).
void set_iteration(coal::NODE_TYPE a, coal::NODE_TYPE b, Pair& pair) {
  const bool closed_form = a == coal::GEOM_HALFSPACE || b == coal::GEOM_HALFSPACE ||
                           (a == coal::GEOM_SPHERE && b == coal::GEOM_CYLINDER) ||
                           (a == coal::GEOM_CYLINDER && b == coal::GEOM_SPHERE);
  const auto is_curved = [](coal::NODE_TYPE type) {
    return type == coal::GEOM_CYLINDER || type == coal::GEOM_ELLIPSOID;
  };
  pair.refined = !closed_form && (is_curved(a) || is_curved(b));
}

// The engine's own copy of the shape of a geometry.
std::shared_ptr<coal::CollisionGeometry> copy_of(const coal::CollisionGeometry& shape, const std::string& name) {
  if (shape.getNodeType() != coal::GEOM_CONVEX) return std::shared_ptr<coal::CollisionGeometry>(shape.clone());
  const auto polytope = polytope_of(shape);
  if (const int most = most_neighbors(polytope); most > kMostShared)
    throw Refusal("The hull of geometry '" + name + "' has a vertex with too many neighbours",
                  "at most " + std::to_string(kMostShared), std::to_string(most),
                  "Simplify the mesh, or replace it by a cylinder, a ball or a box");
  const auto hull = shape_of(polytope);
  static_cast<coal::ShapeBase&>(*hull).setSweptSphereRadius(
      static_cast<const coal::ShapeBase&>(shape).getSweptSphereRadius());
  return hull;
}

// Geometries that have one shape share its copy.
using Copies = std::map<const coal::CollisionGeometry*, std::shared_ptr<coal::CollisionGeometry>>;

Geometry make_geometry(const GivenShape& object, const Tree& tree, Copies& copies) {
  const coal::CollisionGeometry& shape = *object.shape;
  switch (shape.getNodeType()) {
    case coal::GEOM_BOX:
    case coal::GEOM_SPHERE:
    case coal::GEOM_CAPSULE:
    case coal::GEOM_CYLINDER:
    case coal::GEOM_ELLIPSOID:
    case coal::GEOM_CONVEX:
    case coal::GEOM_HALFSPACE:
      break;
    default:
      throw Refusal("Geometry '" + object.name + "' has a shape that the engine does not know",
                    "a box, ball, capsule, cylinder, ellipsoid, convex hull or halfspace", "another one",
                    "Replace it by these shapes, or by convex hulls of its parts");
  }
  Geometry g;
  if (object.joint < 0 || object.joint >= static_cast<int>(tree.body_of_source.size()))
    throw Error("a shape on no joint");
  const Mat3& R_BS = tree.R_body_source[object.joint];
  g.body = tree.body_of_source[object.joint];
  g.R_BG = R_BS * object.R_JG;
  g.p_BG = R_BS * object.p_JG;
  std::shared_ptr<coal::CollisionGeometry>& copy = copies[object.shape];
  if (!copy) {
    copy = copy_of(shape, object.name);
    copy->computeLocalAABB();
  }
  g.sharp = copy;
  g.rounding = 0;
  g.unbounded = shape.getNodeType() == coal::GEOM_HALFSPACE;
  if (g.unbounded) {
    const auto& halfspace = static_cast<const coal::Halfspace&>(shape);
    g.halfspace_normal = halfspace.n;
    g.halfspace_offset = halfspace.d;
    g.center_B.setZero();
    g.radius = g.reach = 0;
    g.box_center = g.box_half = Vec3::Zero();
    g.is_ball = false;
    return g;
  }
  g.center_B = g.R_BG * copy->aabb_center + g.p_BG;
  g.radius = copy->aabb_radius;
  g.reach = g.center_B.norm() + g.radius;
  g.box_center = copy->aabb_center;
  g.box_half = 0.5 * (copy->aabb_local.max_ - copy->aabb_local.min_);
  g.is_ball = shape.getNodeType() == coal::GEOM_SPHERE;
  return g;
}

// Makes the rounded shapes of the geometries that a rounded pair has.
void round_shapes_of_pairs(Scene& scene, const std::vector<GivenShape>& shapes, RoundedHulls* known) {
  std::vector<bool> taken(scene.geometries.size(), false);
  std::vector<Geometry*> chosen;
  std::vector<std::string> names;
  for (const Pair& pair : scene.pairs)
    for (int i : {pair.a, pair.b})
      if (pair.rounded && !taken[i]) {
        taken[i] = true;
        chosen.push_back(&scene.geometries[i]);
        names.push_back(shapes[i].name);
      }
  round_shapes(chosen, names, known);
}

void check_sizes(const PublicModel& model, const GeometryPairs& pairs, const SceneParameters& parameters) {
  const auto joints = static_cast<Eigen::Index>(model.joints.size());
  if (model.armature.size() != model.nv || model.lower.size() != model.nq)
    throw Error("the arrays of the model are for more joints than there are");
  if (parameters.stiffness.size() != joints || parameters.limits.size() != joints ||
      parameters.limit_restitution.size() != joints || parameters.rest.size() != model.nq ||
      parameters.damping.size() != model.nv)
    throw Error("scene parameters do not have the sizes of the model");
  if (parameters.pair_restitution.size() != pairs.rows() || parameters.pair_friction.size() != pairs.rows())
    throw Error("one restitution and one friction per collision pair are needed");
}

}  // namespace

Scene load_scene(std::shared_ptr<const PublicModel> model, const std::vector<GivenShape>& shapes,
                 const GeometryPairs& pairs, const SceneParameters& parameters, RoundedHulls* known) {
  Scene scene;
  check_sizes(*model, pairs, parameters);
  Builder(*model, parameters, scene).build();
  scene.model = std::move(model);
  Copies copies;
  for (const GivenShape& shape : shapes) scene.geometries.push_back(make_geometry(shape, scene.tree, copies));
  const int count = static_cast<int>(scene.geometries.size());
  if (pairs.size() > 0 && (pairs.minCoeff() < 0 || pairs.maxCoeff() >= count)) throw Error("a pair of no geometries");
  scene.pairs.reserve(pairs.rows());
  for (Eigen::Index k = 0; k < pairs.rows(); ++k) {
    Pair pair{pairs(k, 0), pairs(k, 1), parameters.pair_restitution[k], parameters.pair_friction[k], false, false};
    Geometry &a = scene.geometries[pair.a], &b = scene.geometries[pair.b];
    pair.rounded = !needs_no_rounding(a.sharp->getNodeType()) && !needs_no_rounding(b.sharp->getNodeType());
    set_iteration(a.sharp->getNodeType(), b.sharp->getNodeType(), pair);
    scene.pairs.push_back(pair);
  }
  round_shapes_of_pairs(scene, shapes, known);
  return scene;
}

}  // namespace contactvi

// Makes the engine's Scene from Pinocchio's archives. The only file that knows pin.Model and pin.GeometryModel.
#include <boost/archive/binary_iarchive.hpp>
#include <boost/iostreams/device/array.hpp>
#include <boost/iostreams/stream_buffer.hpp>
#include <pinocchio/geometry.hpp>
#include <pinocchio/multibody.hpp>
#include <pinocchio/serialization.hpp>

#include <coal/shape/geometric_shapes.h>

#include <cmath>

#include "base/refusal.hpp"
#include "model/rounding.hpp"
#include "model/scene.hpp"

namespace contactvi {

namespace {

template <class T>
void unpack(T& object, std::string_view bytes, const char* what) {
  try {
    boost::iostreams::stream_buffer<boost::iostreams::basic_array_source<char>> stream(bytes.data(), bytes.size());
    boost::archive::binary_iarchive archive(stream);
    archive >> object;
  } catch (const std::exception& error) {
    throw Error(std::string("the ") + what + " archive could not be read: " + error.what());
  }
}

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

bool starts_with(const std::string& text, const char* prefix) { return text.rfind(prefix, 0) == 0; }

class Builder {
 public:
  Builder(const pinocchio::Model& model, const SceneParameters& parameters, Scene& scene)
      : model_(model), parameters_(parameters), tree_(scene.tree) {}

  void build() {
    const int n = model_.njoints;
    tree_.nq = model_.nq;
    tree_.nv = model_.nv;
    tree_.gravity = model_.gravity.linear();
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
    joint.name = model_.names[source];
    if (last) {
      const auto& Y = model_.inertias[source];
      set_body(joint, Y.mass(), Y.lever(), Y.inertia().matrix(), A);
      tree_.body_of_source[source] = static_cast<int>(tree_.joints.size());
      // R_body_source takes coordinates in the public model's joint frame to the engine's body frame.
      tree_.R_body_source[source] = A.transpose();
    }
    tree_.joints.push_back(joint);
  }

  void add(int i) {
    const auto& source = model_.joints[i];
    const std::string name = source.shortname();
    const int parent_source = static_cast<int>(model_.parents[i]);
    const int parent = tree_.body_of_source[parent_source];
    const Mat3& R_parent = tree_.R_body_source[parent_source];
    const Mat3 R = R_parent * model_.jointPlacements[i].rotation();
    const Vec3 p = R_parent * model_.jointPlacements[i].translation();
    const int iq = source.idx_q(), iv = source.idx_v();
    const Mat3 I = Mat3::Identity();
    const Vec3 zero = Vec3::Zero();
    const int at = static_cast<int>(tree_.joints.size());
    if (name == "JointModelFreeFlyer" || name == "JointModelPlanar") {
      if (!model_.armature.segment(iv, source.nv()).isZero(0) || parameters_.stiffness[i] != 0)
        throw Refusal("Joint '" + model_.names[i] + "' has an armature or a spring", "neither of them on this type",
                      name, "Take them off with scene.set_joint, or build the joint from revolute and prismatic ones");
      tree_.split.push_back({name == "JointModelPlanar", iq, iv});
    }
    if (name == "JointModelFreeFlyer") {
      push(i, JointType::kTranslation, parent, R, p, I, iq, 3, iv, 3, 0, false);
      push(i, JointType::kSpherical, at, I, zero, I, iq + 3, 4, iv + 3, 3, 0, true);
    } else if (name == "JointModelPlanar") {
      const Mat3 X = frame_along(Vec3::UnitX()), Y = frame_along(Vec3::UnitY());
      push(i, JointType::kPrismatic, parent, R, p, X, iq, 1, iv, 1, 0, false);
      push(i, JointType::kPrismatic, at, X.transpose(), zero, Y, iq + 1, 1, iv + 1, 1, 0, false);
      push(i, JointType::kContinuous, at + 1, Y.transpose(), zero, I, iq + 2, 2, iv + 2, 1, 0, true);
    } else if (name == "JointModelTranslation") {
      push(i, JointType::kTranslation, parent, R, p, I, iq, 3, iv, 3, 0, true);
    } else if (name == "JointModelSpherical") {
      push(i, JointType::kSpherical, parent, R, p, I, iq, 4, iv, 3, 0, true);
    } else {
      add_one_dof(i, name, parent, R, p);
    }
  }

  void add_one_dof(int i, const std::string& name, int parent, const Mat3& R, const Vec3& p) {
    const auto& source = model_.joints[i];
    JointType type;
    if (starts_with(name, "JointModelRUB") || name == "JointModelRevoluteUnboundedUnaligned") {
      type = JointType::kContinuous;
    } else if (name == "JointModelRX" || name == "JointModelRY" || name == "JointModelRZ" ||
               name == "JointModelRevoluteUnaligned") {
      type = JointType::kRevolute;
    } else if (name == "JointModelPX" || name == "JointModelPY" || name == "JointModelPZ" ||
               name == "JointModelPrismaticUnaligned") {
      type = JointType::kPrismatic;
    } else if (name == "JointModelHX" || name == "JointModelHY" || name == "JointModelHZ" ||
               name == "JointModelHelicalUnaligned") {
      type = JointType::kHelical;
    } else {
      throw Refusal("Joint '" + model_.names[i] + "' has a type that the engine does not step",
                    "revolute, continuous, prismatic, helical, planar, translation, spherical or free-flyer", name,
                    "Replace it by a chain of revolute and prismatic joints");
    }
    // Axis and pitch are read from the motion subspace, which all types have in the same form.
    pinocchio::JointData data = source.createData();
    VecX q = VecX::Zero(model_.nq);
    if (type == JointType::kContinuous) q[source.idx_q()] = 1;
    source.calc(data, q);
    const Eigen::Matrix<double, 6, 1> S = data.S().matrix().col(0);
    const Vec3 axis = type == JointType::kPrismatic ? S.head<3>() : S.tail<3>();
    const double pitch = type == JointType::kHelical ? S.head<3>().dot(axis) : 0.0;
    push(i, type, parent, R, p, frame_along(axis), source.idx_q(), source.nq(), source.idx_v(), 1, pitch, true);
    if (parameters_.limits[i] != 0) add_limits(i);
  }

  void add_limits(int i) {
    const int iq = model_.joints[i].idx_q(), joint = tree_.body_of_source[i];
    if (model_.joints[i].nq() != 1)
      throw Refusal("Joint '" + model_.names[i] + "' has limits", "limits on joints with one number in q only",
                    model_.joints[i].shortname(), "Take them off: scene.set_joint(name, limits=False)");
    const double lower = model_.lowerPositionLimit[iq], upper = model_.upperPositionLimit[iq];
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

  const pinocchio::Model& model_;
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

Geometry make_geometry(const pinocchio::GeometryObject& object, const Tree& tree) {
  const coal::CollisionGeometry& shape = *object.geometry;
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
  const int source = static_cast<int>(object.parentJoint);
  const Mat3& R_BS = tree.R_body_source[source];
  g.body = tree.body_of_source[source];
  g.R_BG = R_BS * object.placement.rotation();
  g.p_BG = R_BS * object.placement.translation();
  object.geometry->computeLocalAABB();
  g.sharp = object.geometry;
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
  g.center_B = g.R_BG * shape.aabb_center + g.p_BG;
  g.radius = shape.aabb_radius;
  g.reach = g.center_B.norm() + g.radius;
  g.box_center = shape.aabb_center;
  g.box_half = 0.5 * (shape.aabb_local.max_ - shape.aabb_local.min_);
  g.is_ball = shape.getNodeType() == coal::GEOM_SPHERE;
  return g;
}

// The shapes that a rounded pair has.
std::vector<Geometry*> rounded_shapes(Scene& scene) {
  std::vector<bool> taken(scene.geometries.size(), false);
  std::vector<Geometry*> chosen;
  for (const Pair& pair : scene.pairs)
    for (int i : {pair.a, pair.b})
      if (pair.rounded && !taken[i]) {
        taken[i] = true;
        chosen.push_back(&scene.geometries[i]);
      }
  return chosen;
}

// Reads the model into the scene's tree. It is a large one, and is gone before the geometry is read.
void add_tree(Scene& scene, std::string_view model_bytes, const SceneParameters& parameters) {
  pinocchio::Model model;
  unpack(model, model_bytes, "model");
  if (parameters.stiffness.size() != model.njoints || parameters.limits.size() != model.njoints ||
      parameters.limit_restitution.size() != model.njoints || parameters.rest.size() != model.nq ||
      parameters.damping.size() != model.nv)
    throw Error("scene parameters do not have the sizes of the model");
  Builder(model, parameters, scene).build();
}

void set_hulls(pinocchio::GeometryModel& geometry, const std::vector<GivenHull>& hulls) {
  auto& objects = geometry.geometryObjects;
  for (const GivenHull& given : hulls) {
    const auto shape = shape_of(given.hull);
    static_cast<coal::ShapeBase&>(*shape).setSweptSphereRadius(given.swept_radius);
    for (int i : given.geometries) {
      if (i < 0 || i >= static_cast<int>(objects.size())) throw Error("a hull of no geometry");
      objects[i].geometry = shape;
    }
  }
}

GeometryPairs pairs_of(const pinocchio::GeometryModel& geometry) {
  GeometryPairs pairs(geometry.collisionPairs.size(), 2);
  for (std::size_t k = 0; k < geometry.collisionPairs.size(); ++k)
    pairs.row(k) << static_cast<int>(geometry.collisionPairs[k].first),
        static_cast<int>(geometry.collisionPairs[k].second);
  return pairs;
}

}  // namespace

Scene load_scene(std::string_view model_bytes, std::string_view geometry_bytes, const BesideArchive& beside,
                 const SceneParameters& parameters, RoundedHulls* known) {
  Scene scene;
  add_tree(scene, model_bytes, parameters);
  if (geometry_bytes.empty()) return scene;
  pinocchio::GeometryModel geometry;
  unpack(geometry, geometry_bytes, "geometry");
  set_hulls(geometry, beside.hulls);
  for (const auto& object : geometry.geometryObjects) scene.geometries.push_back(make_geometry(object, scene.tree));
  const GeometryPairs own = beside.pairs ? GeometryPairs() : pairs_of(geometry);
  const GeometryPairs& pairs = beside.pairs ? *beside.pairs : own;
  const int count = static_cast<int>(scene.geometries.size());
  if (pairs.size() > 0 && (pairs.minCoeff() < 0 || pairs.maxCoeff() >= count)) throw Error("a pair of no geometries");
  if (parameters.pair_restitution.size() != pairs.rows() || parameters.pair_friction.size() != pairs.rows())
    throw Error("one restitution and one friction per collision pair are needed");
  scene.pairs.reserve(pairs.rows());
  for (Eigen::Index k = 0; k < pairs.rows(); ++k) {
    Pair pair{pairs(k, 0), pairs(k, 1), parameters.pair_restitution[k], parameters.pair_friction[k], false, false};
    Geometry &a = scene.geometries[pair.a], &b = scene.geometries[pair.b];
    if (a.unbounded && b.unbounded) {
      const auto& objects = geometry.geometryObjects;
      throw Refusal("Two halfspaces cannot touch each other", "at most one halfspace in a pair",
                    "'" + objects[pair.a].name + "' and '" + objects[pair.b].name + "'",
                    "Take the pair out: scene.disable_pair(a, b)");
    }
    pair.rounded = !needs_no_rounding(a.sharp->getNodeType()) && !needs_no_rounding(b.sharp->getNodeType());
    set_iteration(a.sharp->getNodeType(), b.sharp->getNodeType(), pair);
    scene.pairs.push_back(pair);
  }
  round_shapes(rounded_shapes(scene), known);
  return scene;
}

}  // namespace contactvi

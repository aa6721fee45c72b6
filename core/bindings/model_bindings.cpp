// A model in public coordinates and its motion.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "base/error.hpp"
#include "bindings/arrays.hpp"
#include "bindings/expose.hpp"
#include "model/tree_motion.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

using Array3 = nb::ndarray<nb::numpy, double, nb::ndim<3>>;

void need_configuration(const PublicModel& model, const VecX& q) {
  if (q.size() != model.nq) throw Error("expected a configuration of shape (nq,)");
}

void need_velocity(const PublicModel& model, const VecX& v) {
  if (v.size() != model.nv) throw Error("expected a vector of shape (nv,)");
}

void need_joint(const PublicModel& model, std::int64_t joint) {
  if (joint < 0 || joint >= static_cast<std::int64_t>(model.joints.size()))
    throw Error("expected the number of a joint");
}

void append(std::vector<double>& to, const Mat3& R) {
  for (int i = 0; i < 3; ++i) to.insert(to.end(), {R(i, 0), R(i, 1), R(i, 2)});
}
void append(std::vector<double>& to, const Vec3& x) { to.insert(to.end(), x.data(), x.data() + 3); }

// The arguments of add_joint, and those of a model with all of its joints: what is pickled.
using JointNumbers = std::tuple<int, int, Vec6, Mat3, Vec3, double, Vec3, Mat3, std::string>;
using Numbers = std::tuple<Vec3, VecX, VecX, VecX, std::vector<JointNumbers>>;

Numbers numbers_of(const PublicModel& model) {
  std::vector<JointNumbers> joints;
  for (std::size_t k = 1; k < model.joints.size(); ++k) {
    const PublicJoint& j = model.joints[k];
    joints.push_back(
        {static_cast<int>(j.type), j.parent, j.subspace, j.R_PJ, j.p_PJ, j.mass, j.centre, j.inertia, j.name});
  }
  return {model.gravity, model.armature, model.lower, model.upper, std::move(joints)};
}

// Rotations (n, 3, 3) and positions (n, 3) of some joints.
auto places_of(const std::vector<JointMotion>& all, const IntVec& joints) {
  const std::size_t n = static_cast<std::size_t>(joints.size());
  std::vector<double> rotations, positions;
  for (std::int64_t joint : joints) {
    append(rotations, all[joint].R_WJ);
    append(positions, all[joint].p_WJ);
  }
  return std::make_pair(hand_over_as<Array3>(std::move(rotations), {n, 3, 3}), hand_over(std::move(positions), n, 3));
}

auto motions(const PublicModel& model, const IntVec& joints, const VecX& q, const VecX& v) {
  need_configuration(model, q);
  need_velocity(model, v);
  for (std::int64_t joint : joints) need_joint(model, joint);
  const std::vector<JointMotion> all = joint_motions(model, q, v, Vec3::Zero());
  std::vector<double> twists;
  for (std::int64_t joint : joints)
    for (const Twist& twist : {all[joint].twist, all[joint].acceleration}) {
      append(twists, twist.lin);
      append(twists, twist.ang);
    }
  auto [rotations, positions] = places_of(all, joints);
  const std::size_t n = static_cast<std::size_t>(joints.size());
  return std::make_tuple(std::move(rotations), std::move(positions),
                         hand_over_as<Array3>(std::move(twists), {n, 2, 6}));
}

auto jacobians(const PublicModel& model, const IntVec& joints, const VecX& q) {
  need_configuration(model, q);
  for (std::int64_t joint : joints) need_joint(model, joint);
  const std::vector<JointMotion> all = joint_places(model, q);
  const std::size_t n = static_cast<std::size_t>(joints.size()), nv = static_cast<std::size_t>(model.nv);
  std::vector<double> J(n * 6 * nv);
  for (std::size_t k = 0; k < n; ++k)
    Eigen::Map<Rows>(J.data() + k * 6 * nv, 6, model.nv) = joint_jacobian(model, all, static_cast<int>(joints[k]));
  auto [rotations, positions] = places_of(all, joints);
  return std::make_tuple(std::move(rotations), std::move(positions), hand_over_as<Array3>(std::move(J), {n, 6, nv}));
}

void expose_tree_motion(nb::module_& m) {
  nb::class_<TreeMotion>(m, "TreeMotion", "A model at q, v and a = dv/dt: points of bodies, and derivatives.")
      .def(
          "rotation",
          [](const TreeMotion& tree, int joint) {
            need_joint(tree.model(), joint);
            return tree.rotation(joint);
          },
          "joint"_a, "R_WJ (3, 3).")
      .def(
          "point",
          [](const TreeMotion& tree, int joint, const Vec3& x) {
            need_joint(tree.model(), joint);
            const PointMotion p = tree.point(joint, x);
            return std::make_tuple(p.place, p.velocity, p.acceleration, Rows(p.J), Rows(p.velocity_q),
                                   Rows(p.acceleration_q), Rows(p.acceleration_v));
          },
          "joint"_a, "x"_a,
          "Place, velocity and acceleration (3,) of a point x [m] of a body, given in the frame of its joint (0: the "
          "world), its Jacobian, and the derivatives in q of its velocity and in q and v of its acceleration, (3, nv); "
          "world axes.")
      .def(
          "turned_force",
          [](const TreeMotion& tree, int joint, const Vec3& x, const Vec3& force) {
            need_joint(tree.model(), joint);
            return Rows(tree.turned_force(joint, x, force));
          },
          "joint"_a, "x"_a, "force"_a,
          "d(J^T force)/dq of the Jacobian of such a point at a constant force [N], world axes, (nv, nv).")
      .def(
          "force_derivatives",
          [](const TreeMotion& tree) {
            MatX by_q, by_v;
            tree.force_derivatives(by_q, by_v);
            return std::make_tuple(Rows(by_q), Rows(by_v));
          },
          "Derivatives in q and v of M a + b at a constant a, (nv, nv) each.");
}

}  // namespace

void expose_model(nb::module_& m) {
  nb::enum_<PublicJointType>(m, "JointType", "The type of a joint of a model.")
      .value("REVOLUTE", PublicJointType::kRevolute)
      .value("CONTINUOUS", PublicJointType::kContinuous)
      .value("PRISMATIC", PublicJointType::kPrismatic)
      .value("HELICAL", PublicJointType::kHelical)
      .value("PLANAR", PublicJointType::kPlanar)
      .value("TRANSLATION", PublicJointType::kTranslation)
      .value("SPHERICAL", PublicJointType::kSpherical)
      .value("FREE", PublicJointType::kFreeFlyer);
  nb::class_<PublicModel>(m, "Model", "The numbers of a pin.Model; velocities and forces are Pinocchio's.")
      .def(nb::init<const Vec3&, VecX, VecX, VecX>(), "gravity"_a, "armature"_a, "lower"_a, "upper"_a)
      .def("add_joint", &PublicModel::add_joint, "type"_a, "parent"_a, "subspace"_a, "R_PJ"_a, "p_PJ"_a, "mass"_a,
           "centre"_a, "inertia"_a, "name"_a,
           "The next joint; subspace (6,): what a unit of the velocity of a joint with one degree of freedom is; "
           "inertia (3, 3): about the centre of mass.")
      .def_ro("nv", &PublicModel::nv)
      .def("__getstate__", &numbers_of)
      .def("__setstate__",
           [](PublicModel& model, const Numbers& numbers) {
             const auto& [gravity, armature, lower, upper, joints] = numbers;
             new (&model) PublicModel(gravity, armature, lower, upper);
             for (const JointNumbers& joint : joints)
               std::apply(
                   [&](int type, const auto&... rest) { model.add_joint(static_cast<PublicJointType>(type), rest...); },
                   joint);
           })
      .def(
          "bias_forces",
          [](const PublicModel& model, const VecX& q, const VecX& v) {
            need_configuration(model, q);
            need_velocity(model, v);
            return bias_forces(model, q, v);
          },
          "q"_a, "v"_a, "Coriolis, centrifugal and gravity forces, (nv,).")
      .def(
          "mass_matrix",
          [](const PublicModel& model, const VecX& q) {
            need_configuration(model, q);
            return Rows(mass_matrix(model, q));
          },
          "q"_a, "M(q), (nv, nv).")
      .def(
          "motions", &motions, "joints"_a, "q"_a, "v"_a,
          "Of some joints (n,) the rotations (n, 3, 3) and positions (n, 3) in the world, and their twists and spatial "
          "accelerations for dv/dt = 0 in their own frames, (n, 2, 6), linear parts first.")
      .def("jacobians", &jacobians, "joints"_a, "q"_a,
           "Of some joints (n,) the rotations (n, 3, 3) and positions (n, 3) in the world, and the Jacobians of their "
           "twists in their own frames, (n, 6, nv), linear parts first.")
      .def(
          "motion",
          [](const PublicModel& model, const VecX& q, const VecX& v, const VecX& a) {
            need_configuration(model, q);
            need_velocity(model, v);
            need_velocity(model, a);
            return TreeMotion(model, q, v, a);
          },
          "q"_a, "v"_a, "a"_a, nb::keep_alive<0, 1>(), "The motion at q (nq,), v (nv,) and a = dv/dt (nv,).");
  expose_tree_motion(m);
}

}  // namespace contactvi

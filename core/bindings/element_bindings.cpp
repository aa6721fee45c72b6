// Forces, actuation and constraints of a scene: added once, before any simulator is made.
#include <nanobind/eigen/dense.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <memory>
#include <tuple>
#include <variant>

#include "base/error.hpp"
#include "bindings/arrays.hpp"
#include "bindings/expose.hpp"
#include "bindings/user_calls.hpp"
#include "bindings/user_functions.hpp"
#include "model/body_twists.hpp"
#include "model/compliance.hpp"
#include "model/constraints.hpp"
#include "model/coordinates.hpp"
#include "model/coupling.hpp"
#include "model/moving_frame.hpp"
#include "model/scene.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

nb::object& UserErrors::kept() {
  // Each thread has its own run. The object is never destroyed, because the interpreter may be gone by then.
  thread_local nb::object* error = new nb::object(nb::none());
  return *error;
}

void UserErrors::keep(nb::python_error& error) {
  if (!any()) kept() = nb::borrow(error.value());
}

nb::object UserErrors::take() {
  nb::object error = kept();
  kept() = nb::none();
  return error;
}

void UserErrors::raise() {
  if (!any()) return;
  const nb::object error = take();
  PyErr_SetObject(reinterpret_cast<PyObject*>(Py_TYPE(error.ptr())), error.ptr());
  throw nb::python_error();
}

namespace {

UserFunctions* functions_of(PyObject* self) {
  if (!nb::inst_ready(self)) return nullptr;
  return static_cast<UserFunctions*>(nb::inst_ptr<Scene>(self)->tree.elements.functions.get());
}

int traverse_functions(PyObject* self, visitproc visit, void* arg) {
  Py_VISIT(Py_TYPE(self));
  if (UserFunctions* functions = functions_of(self))
    for (const nb::object& function : functions->list) Py_VISIT(function.ptr());
  return 0;
}

int clear(PyObject* self) {
  if (UserFunctions* functions = functions_of(self))
    for (nb::object& function : functions->list) function = nb::none();
  return 0;
}

using Vec6 = Eigen::Matrix<double, 6, 1>;
// Signatures of the user's functions, for the stub.
using Motion = nb::typed<nb::callable, std::tuple<double, double, double>(double)>;
using WrenchOfTime = nb::typed<nb::callable, Vec6(double)>;
using Force = nb::typed<nb::callable, VecX(double, VecX, VecX)>;
using ForceDerivatives = nb::typed<nb::callable, std::tuple<MatX, MatX>(double, VecX, VecX)>;
using Potential = nb::typed<nb::callable, double(VecX)>;
using Gradient = nb::typed<nb::callable, VecX(VecX)>;
using Hessian = nb::typed<nb::callable, MatX(VecX)>;

// As guarded, at a state: where iterations diverge, so that it is not finite, the function is not asked.
template <class Result, class Call>
Result guarded_at(bool finite, const UserFunction& function, const Result& otherwise, Call call) {
  return finite ? guarded(function, otherwise, call) : otherwise;
}

BodyFrame frame(const Tree& tree, int joint, const std::optional<Mat3>& R, const Vec3& p) {
  need(joint >= 0 && joint < static_cast<int>(tree.body_of_source.size()), "a frame's joint does not exist");
  const Mat3& R_BS = tree.R_body_source[joint];
  return {tree.body_of_source[joint], R_BS * R.value_or(Mat3(Mat3::Identity())), R_BS * p};
}

// The engine joint of a public joint with one degree of freedom.
int one_dof(const Tree& tree, int joint, bool continuous) {
  need(joint > 0 && joint < static_cast<int>(tree.body_of_source.size()), "the joint does not exist");
  const int found = tree.body_of_source[joint];
  const Joint& j = tree.joints[found];
  need(j.nv == 1 && (j.nq == 1 || continuous), "the joint has not one number in q");
  return found;
}

Signal signal_of(Scene& s, const std::optional<Motion>& function) {
  if (!function) return {};
  return [call = keep(s, *function)](double t) -> std::array<double, 3> {
    return guarded(call, std::array<double, 3>{kNaN, kNaN, kNaN}, [&] {
      const nb::object value = call(t);
      return std::array<double, 3>{nb::cast<double>(value[0]), nb::cast<double>(value[1]), nb::cast<double>(value[2])};
    });
  };
}

void set_joint_friction(Scene& s, const VecX& limits) {
  Elements& e = s.tree.elements;
  need(limits.size() == s.tree.nv, "expected shape (nv,)");
  e.joint_friction = limits;
  e.friction_dofs.clear();
  for (int d = 0; d < s.tree.nv; ++d) {
    need(limits[d] >= 0.0, "joint friction must be >= 0");
    if (limits[d] == 0.0) continue;
    need(s.tree.joints[s.tree.dof_joint[d]].nv == 1, "joint friction is for joints with one degree of freedom");
    e.friction_dofs.push_back(d);
  }
}

void set_servo(Scene& s, const VecX& kp, const VecX& kd, const VecX& effort) {
  for (const VecX* x : {&kp, &kd, &effort}) need(x->size() == s.tree.nv && x->minCoeff() >= 0.0, "expected (nv,) >= 0");
  for (int d = 0; d < s.tree.nv; ++d) {
    const Joint& joint = s.tree.joints[s.tree.dof_joint[d]];
    need((kp[d] == 0.0 && kd[d] == 0.0) || joint.nv == 1, "a servo needs a joint with one degree of freedom");
  }
  s.tree.elements.servo_kp = kp;
  s.tree.elements.servo_kd = kd;
  s.tree.elements.servo_effort = effort;
}

void set_actuator_limits(Scene& s, const VecX& effort, const VecX& velocity) {
  for (const VecX* x : {&effort, &velocity})
    need(x->size() == s.tree.nv && x->minCoeff() >= 0.0, "expected (nv,) >= 0");
  s.tree.elements.effort = effort;
  s.tree.elements.speed = velocity;
}

std::vector<double> list_of(const VecX& values) { return {values.data(), values.data() + values.size()}; }

void add_joint_potential(Scene& s, int joint, double rest, const VecX& coefficients) {
  s.tree.elements.joint_potentials.push_back({one_dof(s.tree, joint, false), rest, list_of(coefficients)});
}

void add_path_spring(Scene& s, const std::vector<int>& joints, const Rows& points, double stiffness, double rest_length,
                     double damping, bool tension_only) {
  need(joints.size() >= 2 && points.rows() == static_cast<Eigen::Index>(joints.size()) && points.cols() == 3,
       "expected at least two points of shape (3,)");
  PathSpring spring{{}, stiffness, rest_length, damping, tension_only};
  for (std::size_t i = 0; i < joints.size(); ++i)
    spring.points.push_back(frame(s.tree, joints[i], std::nullopt, points.row(i).transpose()));
  s.tree.elements.path_springs.push_back(std::move(spring));
}

using OfRows = nb::typed<nb::callable, nb::object(nb::object, bool)>;
using Numbers = nb::ndarray<const double, nb::numpy, nb::c_contig>;

// By a function of Python that takes rows of two or three numbers (width) and returns rows of values, (n, 1) or with
// derivatives (n, 1 + width).
ContactFunction::Rows rows_of(Scene& s, const OfRows& function, std::size_t width) {
  return [call = keep(s, function), width](const double* numbers, int count, bool derivatives, ContactValue* values) {
    const std::size_t n = static_cast<std::size_t>(count), columns = derivatives ? 1 + width : 1;
    // Where iterations diverge, the function is not asked. The force of an impact is infinite.
    bool known = true;
    for (std::size_t k = 0; k < width * n; ++k)
      known = known && (std::isfinite(numbers[k]) || (width == 3 && k % 3 == 1 && numbers[k] > 0.0));
    known = known && guarded(call, false, [&] {
              const std::size_t shape[2] = {n, width};
              nb::ndarray<nb::numpy, const double> given(numbers, 2, shape, nb::handle());
              const auto result = nb::cast<Numbers>(call(given.cast(nb::rv_policy::copy), derivatives));
              if (result.size() != n * columns) throw Error("a law of contact of another shape");
              for (std::size_t k = 0; k < n; ++k) {
                const double* row = result.data() + k * columns;
                values[k] = derivatives ? ContactValue{row[0], row[1], row[2], width == 3 ? row[3] : 0.0}
                                        : ContactValue{row[0]};
              }
              return true;
            });
    if (!known) std::fill_n(values, n, ContactValue{kNaN, kNaN, kNaN, kNaN});
  };
}

// Adds a function of one to three numbers of contacts: of Python, or the address of a C function that sets its value
// and the derivatives; of one number the address is that of a function that returns its value.
int add_contact_function(Scene& s, const std::variant<std::uintptr_t, OfRows>& given, int count) {
  need(count >= 1 && count <= 3, "expected one to three numbers");
  ContactFunction::Rows rows;
  if (const OfRows* function = std::get_if<OfRows>(&given)) {
    rows = rows_of(s, *function, count == 3 ? 3 : 2);
  } else if (count == 1) {
    auto* f = reinterpret_cast<double (*)(double)>(std::get<std::uintptr_t>(given));  // NOLINT: the caller knows
    rows = [f](const double* numbers, int n, bool, ContactValue* values) {
      for (int k = 0; k < n; ++k) values[k] = {f(numbers[2 * k])};
    };
  } else if (count == 3) {
    using OfThree = void(double, double, double, double*);
    auto* f = reinterpret_cast<OfThree*>(std::get<std::uintptr_t>(given));  // NOLINT: the same
    rows = [f](const double* numbers, int n, bool, ContactValue* values) {
      for (int k = 0; k < n; ++k) {
        double found[4] = {kNaN, kNaN, kNaN, kNaN};
        f(numbers[3 * k], numbers[3 * k + 1], numbers[3 * k + 2], found);
        values[k] = {found[0], found[1], found[2], found[3]};
      }
    };
  } else {
    auto* f = reinterpret_cast<void (*)(double, double, double*)>(std::get<std::uintptr_t>(given));  // NOLINT: the same
    rows = [f](const double* numbers, int n, bool, ContactValue* values) {
      for (int k = 0; k < n; ++k) {
        double found[3] = {kNaN, kNaN, kNaN};
        f(numbers[2 * k], numbers[2 * k + 1], found);
        values[k] = {found[0], found[1], found[2]};
      }
    };
  }
  s.tree.elements.contact_functions.push_back(std::make_shared<ContactFunction>(std::move(rows)));
  return static_cast<int>(s.tree.elements.contact_functions.size()) - 1;
}

// Of the compliant pair number `pair`, of geometries a and b.
void add_compliance(Scene& s, int pair, int a, int b, const std::string& name_a, const std::string& name_b,
                    double stiffness, double exponent, double damping, double friction, double slip_speed,
                    const std::array<int, 3>& functions) {
  const int count = static_cast<int>(s.geometries.size());
  need(a >= 0 && a < count && b >= 0 && b < count, "a pair of no geometries");
  need(stiffness >= 0.0 && exponent >= 1.0 && damping >= 0.0 && friction >= 0.0 && slip_speed > 0.0,
       "a compliance has numbers that are not negative, an exponent from 1 on, and a slip speed above 0");
  ComplianceLaw law{stiffness, exponent, damping, friction, slip_speed};
  const auto function = [&](int k) {
    need(k < static_cast<int>(s.tree.elements.contact_functions.size()), "there is no such function of contacts");
    return k < 0 ? nullptr : s.tree.elements.contact_functions[static_cast<std::size_t>(k)];
  };
  law.force = function(functions[0]);
  law.energy = function(functions[1]);
  law.bound = function(functions[2]);
  for (const TouchingPair& found : touching_pairs(s, a, b, name_a, name_b)) {
    const int first = found.reversed ? b : a, second = found.reversed ? a : b;
    s.tree.elements.compliances.push_back(
        {s.geometries[first].body, s.geometries[second].body, law, found.shapes, pair, found.reversed});
  }
}

// The compliant contacts that overlap at states (n, nq), (n, nv) in public coordinates: the number of the state and of
// the pair (m, 2), and the depth, normal from the first shape to the second one, point, and force on the second shape,
// (m, 10), in the world.
std::pair<Array2, Array2> compliant_contacts(const Scene& s, const Rows& q, const Rows& v) {
  need(q.cols() == s.tree.nq && v.cols() == s.tree.nv && q.rows() == v.rows(), "expected shapes (n, nq) and (n, nv)");
  std::vector<std::array<double, 12>> found;
  BodyTwists bodies(s.tree);
  for (Eigen::Index i = 0; i < q.rows(); ++i) {
    const VecX at = q.row(i).transpose();
    VecX speed = v.row(i).transpose();
    public_to_engine(s.tree, at, speed);
    bodies.place(at);
    bodies.move(speed);
    std::vector<std::tuple<const CompliantContact*, Touch<double>, Vec3>> met;  // velocity of a against b
    std::vector<AskedPress> asked;
    for (const CompliantContact& c : s.tree.elements.compliances) {
      const Touch<double> touch = touch_of(c, bodies.placements());
      if (!(touch.gap < 0.0)) continue;
      const Vec3 w = bodies.velocity(c.body_a, touch.point) - bodies.velocity(c.body_b, touch.point);
      met.emplace_back(&c, touch, w);
      asked.push_back(asked_press(c.law, touch, w));
    }
    ask(asked, false);
    for (std::size_t k = 0; k < met.size(); ++k) {
      const auto& [contact, touch, w] = met[k];
      const CompliantContact& c = *contact;
      const bool acts = presses(c.law, touch.gap, asked[k].along, asked[k].given);
      const Vec3 force = acts ? press_of(c.law, touch, w, asked[k].given).force : Vec3(Vec3::Zero());
      const double sign = c.reversed ? 1.0 : -1.0;  // the normal is from b to a, and the force that on a
      const Vec3 n = sign * touch.normal, f = sign * force;
      found.push_back({static_cast<double>(i), static_cast<double>(c.pair), -touch.gap, n[0], n[1], n[2],
                       touch.point[0], touch.point[1], touch.point[2], f[0], f[1], f[2]});
    }
  }
  s.tree.elements.forget_failure();
  UserErrors::raise();
  const auto rows = static_cast<Eigen::Index>(found.size());
  Rows numbers(rows, 2), values(rows, 10);
  for (Eigen::Index k = 0; k < rows; ++k)
    for (int j = 0; j < 12; ++j) (j < 2 ? numbers(k, j) : values(k, j - 2)) = found[static_cast<std::size_t>(k)][j];
  return {hand_over(std::move(numbers)), hand_over(std::move(values))};
}

// Number of the pair and gap of all compliant contacts, (m, 2).
Array2 compliant_gaps(const Scene& s, const VecX& q) {
  need(q.size() == s.tree.nq, "expected shape (nq,)");
  const std::vector<CompliantContact>& contacts = s.tree.elements.compliances;
  Placements at(s.tree);
  place(s.tree, q, at);
  Rows found(static_cast<Eigen::Index>(contacts.size()), 2);
  for (std::size_t k = 0; k < contacts.size(); ++k) {
    found(static_cast<Eigen::Index>(k), 0) = contacts[k].pair;
    found(static_cast<Eigen::Index>(k), 1) = touch_of(contacts[k], at).gap;
  }
  return hand_over(std::move(found));
}

void add_wrench(Scene& s, int joint, const Vec3& point, const std::optional<Mat3>& R,
                const std::variant<Vec6, WrenchOfTime>& wrench) {
  AppliedWrench w{frame(s.tree, joint, R, point), !R, Vec6::Zero(), {}};
  if (const WrenchOfTime* function = std::get_if<WrenchOfTime>(&wrench)) {
    w.signal = [wrench = keep(s, *function)](double t) -> Vec6 {
      return guarded(wrench, Vec6(Vec6::Constant(kNaN)), [&] { return nb::cast<Vec6>(wrench(t)); });
    };
  } else {
    w.value = std::get<Vec6>(wrench);
  }
  s.tree.elements.wrenches.push_back(std::move(w));
}

void add_user_force(Scene& s, const Force& value, const std::optional<ForceDerivatives>& derivatives) {
  UserForce force;
  const int nv = s.tree.nv;
  force.value = [value = keep(s, value), nv](double t, const VecX& q, const VecX& v, VecX& f) {
    f = guarded_at(q.allFinite() && v.allFinite(), value, VecX(VecX::Constant(nv, kNaN)), [&] {
      VecX result = nb::cast<VecX>(value(t, q, v));
      if (result.size() != nv) throw Error("a user's force has the wrong size");
      return result;
    });
  };
  if (derivatives)
    force.derivative = [derivatives = keep(s, *derivatives), nv](double t, const VecX& q, const VecX& v, MatX& dq,
                                                                 MatX& dv) {
      const MatX nan = MatX::Constant(nv, nv, kNaN);
      std::tie(dq, dv) = guarded_at(q.allFinite() && v.allFinite(), derivatives, std::make_tuple(nan, nan), [&] {
        const nb::object result = derivatives(t, q, v);
        auto both = std::make_tuple(nb::cast<MatX>(result[0]), nb::cast<MatX>(result[1]));
        for (const MatX* m : {&std::get<0>(both), &std::get<1>(both)})
          if (m->rows() != nv || m->cols() != nv) throw Error("a user's derivative has the wrong size");
        return both;
      });
    };
  s.tree.elements.forces.push_back(std::move(force));
}

void add_user_potential(Scene& s, const Potential& value, const Gradient& gradient,
                        const std::optional<Hessian>& hessian) {
  UserPotential p;
  const int nv = s.tree.nv;
  p.value = [value = keep(s, value)](const VecX& q) {
    return guarded_at(q.allFinite(), value, kNaN, [&] { return nb::cast<double>(value(q)); });
  };
  p.gradient = [gradient = keep(s, gradient), nv](const VecX& q, VecX& g) {
    g = guarded_at(q.allFinite(), gradient, VecX(VecX::Constant(nv, kNaN)), [&] {
      VecX result = nb::cast<VecX>(gradient(q));
      if (result.size() != nv) throw Error("a user's gradient has the wrong size");
      return result;
    });
  };
  if (hessian)
    p.hessian = [hessian = keep(s, *hessian), nv](const VecX& q, MatX& H) {
      H = guarded_at(q.allFinite(), hessian, MatX(MatX::Constant(nv, nv, kNaN)), [&] {
        MatX result = nb::cast<MatX>(hessian(q));
        if (result.rows() != nv || result.cols() != nv) throw Error("a user's hessian has the wrong size");
        return result;
      });
    };
  s.tree.elements.potentials.push_back(std::move(p));
}

// Into the constraints that were given and, unless it couples joints, into those of the steps.
void push_constraint(Elements& e, Constraint c, bool coupled) {
  Constraint given = c;
  given.row = e.given_rows;
  e.given_rows += c.rows;
  e.given_constraints.push_back(std::move(given));
  if (coupled) return;
  e.constraint_rows += c.rows;
  e.constraints.push_back(std::move(c));
}

void add_constraint(Scene& s, ConstraintKind kind, int joint_a, const std::optional<Mat3>& R_a, const Vec3& p_a,
                    int joint_b, const std::optional<Mat3>& R_b, const Vec3& p_b, const VecX& numbers,
                    const std::optional<Motion>& signal, const std::string& name, bool coupled) {
  Elements& e = s.tree.elements;
  Constraint c{kind, {}, {}, -1, -1, list_of(numbers), signal_of(s, signal), e.constraint_rows, 0};
  switch (c.kind) {
    case ConstraintKind::kEquality:
      c.joint_a = one_dof(s.tree, joint_a, false);
      c.joint_b = one_dof(s.tree, joint_b, false);
      break;
    case ConstraintKind::kPrescribed:
      need(static_cast<bool>(c.signal), "a prescribed joint needs a signal");
      c.joint_b = one_dof(s.tree, joint_b, true);
      break;
    default:
      c.a = frame(s.tree, joint_a, R_a, p_a);
      c.b = frame(s.tree, joint_b, R_b, p_b);
      need(c.kind != ConstraintKind::kScrew || numbers.size() == 2, "a screw has two numbers");
      need(c.kind != ConstraintKind::kDistance || c.signal || numbers.size() == 1, "a distance has one number");
  }
  c.rows = constraint_rows(c.kind);
  c.name = name.empty() ? "constraint " + std::to_string(e.given_constraints.size()) : name;
  push_constraint(e, std::move(c), coupled);
}

using GivenCoupling = std::tuple<int, double, std::vector<std::pair<int, double>>>;

// Couples joints for which constraints were added as coupled: follower, offset, and the leaders with their ratios.
// lent: armature with S^T diag S = 0, (nv,) or empty.
void couple_joints(Scene& s, const std::vector<GivenCoupling>& couplings, const VecX& lent) {
  Tree& tree = s.tree;
  std::vector<Follower> followers;
  std::vector<char> follows(tree.joints.size(), 0);
  for (const auto& [joint, offset, leaders] : couplings) {
    Follower f{one_dof(tree, joint, false), offset, {}};
    need(!leaders.empty(), "a coupled joint follows at least one other");
    need(follows[f.joint] == 0, "a joint follows others once");
    follows[f.joint] = 1;
    for (const auto& [leader, ratio] : leaders) f.leaders.push_back({one_dof(tree, leader, false), ratio});
    followers.push_back(std::move(f));
  }
  for (const Follower& f : followers)
    for (const Follower::Leader& leader : f.leaders) need(follows[leader.joint] == 0, "leaders follow no others");
  set_followers(tree, std::move(followers));
  need(lent.size() == 0 || lent.size() == tree.nv, "expected shape (nv,)");
  if (lent.size() == 0) return;
  tree.lent_armature = lent;
  tree.armature += lent;
}

using PoseFunction = nb::typed<nb::callable, std::tuple<Vec3, Mat3, Vec3, Vec3>(double)>;

void add_prescribed_pose(Scene& s, int joint, const Mat3& R, const Vec3& p, const PoseFunction& pose,
                         const std::string& name) {
  Elements& e = s.tree.elements;
  MovingFrame moving{[call = keep(s, pose)](double t) -> FrameMotion {
    const Vec3 nan = Vec3::Constant(kNaN);
    return guarded(call, FrameMotion{nan, Mat3::Constant(kNaN), nan, nan}, [&] {
      const nb::object value = call(t);
      return FrameMotion{nb::cast<Vec3>(value[0]), nb::cast<Mat3>(value[1]), nb::cast<Vec3>(value[2]),
                         nb::cast<Vec3>(value[3])};
    });
  }};
  Constraint c{
      ConstraintKind::kWeld, {}, frame(s.tree, joint, R, p), -1, -1, {}, std::move(moving), e.constraint_rows, 0, name};
  c.rows = constraint_rows(c.kind);
  push_constraint(e, std::move(c), false);
}

// phi (m,), W (nv, m) in engine coordinates and rate (m,) of all constraints.
struct Evaluated {
  VecX phi, rate;
  MatX W;
};

Evaluated evaluate(const Scene& s, const VecX& q, double t) {
  need(q.size() == s.tree.nq, "expected shape (nq,)");
  const int m = s.tree.elements.given_rows;
  Evaluated e{VecX::Zero(m), VecX::Zero(m), MatX::Zero(s.tree.nv, m)};
  Placements at(s.tree);
  place(s.tree, q, at);
  evaluate_given_constraints(s.tree, at, q, t, e.phi, e.W, e.rate);
  s.tree.elements.forget_failure();
  UserErrors::raise();
  return e;
}

Array2 jacobian(const Scene& s, const VecX& q, double t) {
  Evaluated e = evaluate(s, q, t);
  for (Eigen::Index k = 0; k < e.W.cols(); ++k) engine_to_public(s.tree, q, e.W.col(k));
  return hand_over(Rows(e.W.transpose()));
}

std::vector<int> rows_per_constraint(const Scene& s) {
  std::vector<int> rows;
  for (const Constraint& c : s.tree.elements.given_constraints) rows.push_back(c.rows);
  return rows;
}

}  // namespace

PyType_Slot scene_slots[] = {{Py_tp_traverse, reinterpret_cast<void*>(&traverse_functions)},
                             {Py_tp_clear, reinterpret_cast<void*>(&clear)},
                             {0, nullptr}};

void expose_elements(nb::class_<Scene>& scene) {
  scene
      .def("set_joint_friction", &set_joint_friction, "limits"_a, "Largest friction force of each dof [N; N m], (nv,).")
      .def("add_joint_potential", &add_joint_potential, "joint"_a, "rest"_a, "coefficients"_a,
           "Add V = sum_k c[k] x^(k+2), x = q - rest.")
      .def("add_path_spring", &add_path_spring, "joints"_a, "points"_a, "stiffness"_a, "rest_length"_a, "damping"_a,
           "tension_only"_a, "Add a spring along a line through points (n, 3) in the frames of joints.")
      .def("add_compliance", &add_compliance, "pair"_a, "a"_a, "b"_a, "name_a"_a, "name_b"_a, "stiffness"_a,
           "exponent"_a, "damping"_a, "friction"_a, "slip_speed"_a, "functions"_a = std::array<int, 3>{-1, -1, -1},
           "Let two geometries press on each other by a law of their gap; see core/model/elements.hpp. functions: the "
           "numbers of those of force, energy and bound on friction (add_contact_function), -1: none.")
      .def(
          "add_contact_function", &add_contact_function, "function"_a, "numbers"_a,
          "Adds a function of `numbers` numbers of contacts, of rows (n, 2) or (n, 3) and whether derivatives are "
          "wanted, which returns rows of the value (n, 1) or value and derivatives (n, 3) or (n, 4); or the address of "
          "a C function void(double, double, double[3]), void(double, double, double, double[4]), of one number "
          "double(double). Returns its number.")
      .def(
          "compliant_contacts", &compliant_contacts, "q"_a, "v"_a,
          "The compliant contacts that overlap at states: (state, pair) (m, 2), (depth, normal, point, force) (m, 10).")
      .def("compliant_gaps", &compliant_gaps, "q"_a, "(pair, gap) of all compliant contacts, (m, 2).")
      .def("add_wrench", &add_wrench, "joint"_a, "point"_a, "R"_a.none(), "wrench"_a,
           "(force, torque) (6,) or a function of t, in the axes R of the joint's frame; without R in those of the "
           "world.")
      .def("add_user_force", &add_user_force, "value"_a, "derivatives"_a = nb::none(), "value(t, q, v) -> (nv,).")
      .def("add_user_potential", &add_user_potential, "value"_a, "gradient"_a, "hessian"_a = nb::none(),
           "value(q) [J], gradient(q) -> (nv,).")
      .def("add_constraint", &add_constraint, "kind"_a, "joint_a"_a, "R_a"_a.none(), "p_a"_a, "joint_b"_a,
           "R_b"_a.none(), "p_b"_a, "numbers"_a, "signal"_a = nb::none(), "name"_a = "", "coupled"_a = false,
           "Frames of two bodies or joints, numbers or their motion; see core/model/constraints.hpp. A coupled one is "
           "for couple_joints.")
      .def("couple_joints", &couple_joints, "couplings"_a, "lent_armature"_a,
           "Let joints follow others: (joint, offset, [(leader, ratio), ...]) each; see core/model/coupling.hpp. The "
           "lent armature (nv,), or empty, is no inertia of the coupled motion.")
      .def("add_prescribed_pose", &add_prescribed_pose, "joint"_a, "R"_a, "p"_a, "pose"_a, "name"_a,
           "Let a frame of a body follow pose(t) -> (position, rotation, velocity, angular velocity), world frame.")
      .def("set_servo", &set_servo, "kp"_a, "kd"_a, "effort"_a,
           "Gains and largest torque of the servos of joints with one degree of freedom, (nv,) each.")
      .def("set_actuator_limits", &set_actuator_limits, "effort"_a, "velocity"_a,
           "Largest effort [N; N m] and speed [m/s; rad/s] of the actuators, (nv,) each; inf is no limit.")
      .def_prop_ro(
          "followers",
          [](const Scene& s) {
            std::vector<int> joints;
            for (const Follower& f : s.tree.followers)
              for (std::size_t k = 0; k < s.tree.body_of_source.size(); ++k)
                if (s.tree.body_of_source[k] == f.joint) joints.push_back(static_cast<int>(k));
            return joints;
          },
          "The joints that follow others, in the order of their columns in the reactions of a run.")
      .def_prop_ro("constraint_rows", &rows_per_constraint, "Number of rows of each constraint.")
      .def(
          "constraint_residual",
          [](const Scene& s, const VecX& q, double t) { return hand_over(evaluate(s, q, t).phi); }, "q"_a, "t"_a = 0.0,
          "phi(q, t), (m,).")
      .def("constraint_jacobian", &jacobian, "q"_a, "t"_a = 0.0, "d phi/dq in public coordinates, (m, nv).")
      .def(
          "constraint_rate", [](const Scene& s, const VecX& q, double t) { return hand_over(evaluate(s, q, t).rate); },
          "q"_a, "t"_a = 0.0, "d phi/dt at fixed q, (m,).");
}

}  // namespace contactvi

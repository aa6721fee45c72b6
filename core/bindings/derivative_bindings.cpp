// Derivatives of steps, in public coordinates.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <limits>
#include <tuple>
#include <variant>
#include <vector>

#include "base/error.hpp"
#include "base/refusal.hpp"
#include "bindings/arrays.hpp"
#include "bindings/expose.hpp"
#include "bindings/obstacle.hpp"
#include "bindings/parameter_results.hpp"
#include "bindings/user_calls.hpp"
#include "event/clear_step.hpp"
#include "geometry/contact_tangent.hpp"
#include "geometry/guard.hpp"
#include "model/scene.hpp"
#include "sensitivity/linear_contact_step.hpp"
#include "step/linearize.hpp"
#include "step/step_gradient.hpp"
#include "step/step_tangent.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

void need_state(const Tree& tree, const VecX& q, const VecX& x) {
  if (q.size() != tree.nq || x.size() != tree.nv) throw Error("expected shapes (nq,) and (nv,)");
}

void need_order(int order) {
  if (order < 2 || order > 2 * kMaxStages || order % 2 != 0) throw Error("order must be 2, 4, ... 16");
}

// The inputs of a step; target: references of the servos, (2 nv,).
StepInputs inputs_of(const Tree& tree, double t, const std::optional<VecX>& tau, const std::optional<VecX>& target) {
  if (tau && tau->size() != tree.nv) throw Error("tau: expected shape (nv,)");
  if (target && target->size() != 2 * tree.nv) throw Error("target: expected shape (2 nv,)");
  StepInputs inputs{t, tau ? *tau : VecX(), Servo()};
  const Elements& e = tree.elements;
  if (e.servo_kp.size() == 0) return inputs;
  Servo& servo = inputs.servo;
  servo.any = true;
  servo.kp = e.servo_kp;
  servo.kd = e.servo_kd;
  servo.feed = VecX::Zero(tree.nv);
  servo.q_ref = target ? VecX(target->head(tree.nv)) : VecX(VecX::Zero(tree.nv));
  servo.v_ref = target ? VecX(target->tail(tree.nv)) : VecX(VecX::Zero(tree.nv));
  return inputs;
}

using LinearArrays = std::tuple<VecX, VecX, Rows, Rows, VecX>;

LinearArrays linear_step(const Scene& s, const VecX& q, const VecX& x, bool momentum, double h,
                         const std::optional<VecX>& tau, const std::optional<VecX>& target, double t, int order,
                         double tol, bool by_columns) {
  need_state(s.tree, q, x);
  need_order(order);
  const StateKind kind = momentum ? StateKind::kMomentum : StateKind::kVelocity;
  const StepInputs inputs = inputs_of(s.tree, t, tau, target);
  StepLinearizer linearizer(s.tree, order / 2, tol);
  const LinearStep& step =
      by_columns ? linearizer.solve_by_columns(q, x, kind, h, inputs) : linearizer.solve(q, x, kind, h, inputs);
  UserErrors::raise();
  return {step.q1, step.x1, Rows(step.A), Rows(step.B), step.h};
}

std::variant<LinearArrays, Dict> linear_contact_step(const Scene& s, const VecX& q, const VecX& x, bool momentum,
                                                     double h, const std::optional<VecX>& tau,
                                                     const std::optional<VecX>& target, double t, int order,
                                                     double tol) {
  need_state(s.tree, q, x);
  need_order(order);
  const StateKind kind = momentum ? StateKind::kMomentum : StateKind::kVelocity;
  try {
    const StepInputs inputs = inputs_of(s.tree, t, tau, target);
    const LinearStep step = order > 2 ? linearize_held_step(s, q, x, kind, h, inputs, order / 2, tol)
                                      : linearize_contact_step(s, q, x, kind, h, inputs);
    UserErrors::raise();
    return LinearArrays{step.q1, step.x1, Rows(step.A), Rows(step.B), step.h};
  } catch (const NoDerivative& reason) {
    UserErrors::raise();
    return obstacle_of(s, reason);
  }
}

// Linearises steps of a scene that are beyond doubt without contact, from starts that have a velocity.
class Linearizer {
 public:
  Linearizer(const Scene& scene, int order, double tol)
      : scene_(&scene), linearizer_(scene.tree, (need_order(order), order / 2), tol), clear_(scene, order / 2) {}

  std::optional<LinearArrays> step(const VecX& q, const VecX& x, bool momentum, double h,
                                   const std::optional<VecX>& tau, const std::optional<VecX>& target, double t) {
    need_state(scene_->tree, q, x);
    const StateKind kind = momentum ? StateKind::kMomentum : StateKind::kVelocity;
    const StepInputs inputs = inputs_of(scene_->tree, t, tau, target);
    try {
      const LinearStep& step = linearizer_.solve(q, x, kind, h, inputs);
      UserErrors::raise();
      if (!(linearizer_.lost_velocity() <= kMostLost) ||
          !clear_.check(linearizer_.step(), linearizer_.integrator(), inputs, h))
        return std::nullopt;
      return LinearArrays{step.q1, step.x1, Rows(step.A), Rows(step.B), step.h};
    } catch (const Refusal&) {
      UserErrors::raise();
      return std::nullopt;
    }
  }

  const Scene& scene() const { return *scene_; }

 private:
  // Far below what the check of a start refuses (MOST_LOST in trajectory/compiled.py), which is made where it is more.
  static constexpr double kMostLost = 1e-5;
  const Scene* scene_;
  StepLinearizer linearizer_;
  ClearStep clear_;
};

// The scene is kept alive, which the garbage collector has to see.
int traverse_linearizer(PyObject* self, visitproc visit, void* arg) {
  Py_VISIT(Py_TYPE(self));
  if (!nb::inst_ready(self)) return 0;
  nb::object scene = nb::find(nb::inst_ptr<Linearizer>(self)->scene());
  Py_VISIT(scene.ptr());
  return 0;
}

PyType_Slot linearizer_slots[] = {{Py_tp_traverse, reinterpret_cast<void*>(&traverse_linearizer)}, {0, nullptr}};

std::tuple<VecX, VecX, VecX, double, Parameters> adjoint_step(const Scene& s, const VecX& q, const VecX& x,
                                                              bool momentum, double h, const VecX& lq, const VecX& lx,
                                                              const std::optional<VecX>& tau,
                                                              const std::optional<VecX>& target, double t, int order,
                                                              double tol) {
  need_state(s.tree, q, x);
  need_order(order);
  if (lq.size() != s.tree.nv || lx.size() != s.tree.nv) throw Error("lq, lx: expected shape (nv,)");
  const StateKind kind = momentum ? StateKind::kMomentum : StateKind::kVelocity;
  const StepGradient found =
      pull_back_step(s.tree, q, x, kind, h, inputs_of(s.tree, t, tau, target), order / 2, tol, lq, lx);
  UserErrors::raise();
  return {found.q, found.x, found.tau, found.h, parameters_of(s.tree, found.parameters)};
}

using NamedNumbers = nb::typed<nb::dict, nb::str, double>;

// Seconds and iterations of one direction of the tangent and of one transposed derivative of the same step.
NamedNumbers derivative_costs(const Scene& s, const VecX& q, const VecX& v, double h, int order, int calls,
                              int repeats) {
  need_state(s.tree, q, v);
  need_order(order);
  const int n = s.tree.nv;
  const StepInputs inputs{0.0, VecX(), Servo()};
  Integrator integrator(s.tree, order / 2, 1e-12, kStepIterations);
  PublicStep step(s.tree, q, v, StateKind::kVelocity, h, inputs, integrator);
  StepTangent tangent(s.tree, order / 2);
  StepAdjoint adjoint(s.tree, order / 2);
  step.give(tangent);
  step.give(adjoint);
  StepDirection direction;
  direction.q = direction.p = VecX::LinSpaced(n, 0.5, 1.0);
  VecX a(n), b(n), tau(n);
  double by_h = 0.0;
  NamedNumbers d;
  double fastest[4];
  std::fill_n(fastest, 4, std::numeric_limits<double>::infinity());
  for (int r = 0; r < repeats; ++r) {
    const auto time = [&](int which, auto&& call) {
      const auto start = std::chrono::steady_clock::now();
      for (int k = 0; k < calls; ++k) call();
      const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - start;
      fastest[which] = std::min(fastest[which], taken.count() / calls);
    };
    time(0, [&] { tangent.solve(direction, a, b); });
    time(1, [&] { adjoint.solve(direction.q, direction.p, a, b, by_h, tau); });
    time(2, [&] { step.give(tangent); });
    time(3, [&] { step.give(adjoint); });
  }
  d["tangent"] = fastest[0];
  d["adjoint"] = fastest[1];
  d["take_tangent"] = fastest[2];
  d["take_adjoint"] = fastest[3];
  d["tangent_iterations"] = static_cast<double>(tangent.iterations());
  d["adjoint_iterations"] = static_cast<double>(adjoint.iterations());
  return d;
}

std::tuple<VecX, Rows, Rows> linear_forces(const Scene& s, const VecX& q, const VecX& v,
                                           const std::optional<VecX>& target, double t) {
  need_state(s.tree, q, v);
  const LinearForces forces = linearize_forces(s.tree, q, v, inputs_of(s.tree, t, std::nullopt, target));
  UserErrors::raise();
  return {forces.f, Rows(forces.f_q), Rows(forces.f_v)};
}

VecX passive_forces_at(const Scene& s, const VecX& q, const VecX& v, double t) {
  need_state(s.tree, q, v);
  VecX f = passive_forces(s.tree, q, v, t);
  s.tree.elements.forget_failure();
  UserErrors::raise();
  return f;
}

// The contact of a guard at q, or that of a contact point of the pair with a known feature, ready to be differentiated.
struct TouchedPair {
  TouchedPair(const Scene& scene, const VecX& q, int guard, std::int64_t feature) : guards(scene), tangent(scene) {
    if (q.size() != scene.tree.nq) throw Error("expected shape (nq,)");
    if (guard < 0 || guard >= guards.count()) throw Error("there is no such guard");
    guards.place(q);
    guards.evaluate_witness(guard, contact);
    ContactPoint point{};
    if (feature != 0) {
      if (!scene.is_pair(guard)) throw Error("a joint limit has no features");
      point = guards.manifolds().point(guard, guards.placements(), contact, feature);
      guards.manifolds().evaluate(point, guards.placements(), contact);
    }
    if (!tangent.take(q, guard, contact, feature != 0 ? &point : nullptr))
      throw Refusal("The gap has no second derivative there", "one nearest point", tangent.why(),
                    "Take a configuration where the bodies meet in a single point of each");
    guards.placements();  // of all bodies, for the rows
  }

  Guards guards;
  ContactTangent tangent;
  Contact contact{};
};

std::tuple<double, VecX, Rows> gap_hessian(const Scene& s, const VecX& q, int guard, std::int64_t feature) {
  TouchedPair touch(s, q, guard, feature);
  const int nv = s.tree.nv;
  VecX W(nv);
  touch.guards.gradient(guard, touch.tangent.contact(), W);
  MatX dW(nv, 1);
  Rows columns(nv, nv);
  const Vec3 t1 = any_tangent(touch.tangent.contact().normal);
  for (int k = 0; k < nv; ++k) {
    touch.tangent.change(VecX::Unit(nv, k), t1, dW);
    columns.col(k) = dW;
  }
  return {touch.tangent.contact().gap, W, columns};
}

std::tuple<Rows, std::vector<Rows>, Rows> contact_row_changes(const Scene& s, const VecX& q, int guard, const Vec3& t1,
                                                              std::int64_t feature) {
  TouchedPair touch(s, q, guard, feature);
  const int nv = s.tree.nv;
  MatX W = MatX::Zero(nv, 3), dW(nv, 3);
  touch.guards.rows(guard, touch.tangent.contact(), t1, W);
  std::vector<Rows> changes(3, Rows(nv, nv));
  Rows places(9, nv);
  for (int k = 0; k < nv; ++k) {
    touch.tangent.change(VecX::Unit(nv, k), t1, dW);
    for (int i = 0; i < 3; ++i) changes[i].col(k) = dW.col(i);
    places.col(k) << touch.tangent.normal_change(), touch.tangent.point_a_change(), touch.tangent.point_b_change();
  }
  return {Rows(W), changes, places};
}

}  // namespace

void expose_derivatives(nb::module_& m) {
  m.def("linear_step", &linear_step, "scene"_a, "q"_a, "x"_a, "momentum"_a, "h"_a, "tau"_a = nb::none(),
        "target"_a = nb::none(), "t"_a = 0.0, "order"_a = 2, "tol"_a = 1e-12, "by_columns"_a = false,
        "One smooth step and its derivatives: (q1, x1, A (2 nv, 2 nv), B (2 nv, nv), d(q1, x1)/dh (2 nv,)), x being "
        "the velocity or the momentum; target: references of the servos (2 nv,). by_columns: by the slow way, which "
        "solves one tangent equation per column.");
  m.def("linear_contact_step", &linear_contact_step, "scene"_a, "q"_a, "x"_a, "momentum"_a, "h"_a, "tau"_a = nb::none(),
        "target"_a = nb::none(), "t"_a = 0.0, "order"_a = 2, "tol"_a = 1e-12,
        "As linear_step(), of a step with impulses of constraints and joint friction, without contacts; or the reason "
        "why there is none.");
  nb::class_<Linearizer>(m, "Linearizer", nb::type_slots(linearizer_slots))
      .def(nb::init<const Scene&, int, double>(), "scene"_a, "order"_a, "tol"_a, nb::keep_alive<1, 2>())
      .def("step", &Linearizer::step, "q"_a, "x"_a, "momentum"_a, "h"_a, "tau"_a.none(), "target"_a.none(), "t"_a,
           "As linear_step(); None where the step is not solved, or not beyond doubt without contacts, actuators at "
           "their limits and motions without inertia.");
  m.def(
      "adjoint_step", &adjoint_step, "scene"_a, "q"_a, "x"_a, "momentum"_a, "h"_a, "lq"_a, "lx"_a, "tau"_a = nb::none(),
      "target"_a = nb::none(), "t"_a = 0.0, "order"_a = 2, "tol"_a = 1e-12,
      "From a gradient (lq, lx) (nv,) in the end (q1, x1) of a smooth step, dual to tangent vectors, to those in q, x "
      "and tau (nv,), h, and the parameters by name; inertia (njoints, 10): mass, first moment, rotational inertia "
      "about the joint's frame (xx xy xz yy yz zz).");
  m.def("derivative_costs", &derivative_costs, "scene"_a, "q"_a, "v"_a, "h"_a, "order"_a = 2, "calls"_a = 1,
        "repeats"_a = 1,
        "Seconds and iterations of one direction of a step's derivative and of its transpose, and seconds to prepare "
        "each, fastest of several blocks; for benchmarks.");
  m.def("linear_forces", &linear_forces, "scene"_a, "q"_a, "v"_a, "target"_a = nb::none(), "t"_a = 0.0,
        "Forces of springs, dampers, servos and elements and their derivatives: (f (nv,), f_q, f_v (nv, nv)).");
  m.def("passive_forces", &passive_forces_at, "scene"_a, "q"_a, "v"_a, "t"_a = 0.0,
        "Forces of springs, dampers and elements, (nv,); without servos, gravity, contacts and constraints.");
  m.def("gap_hessian", &gap_hessian, "scene"_a, "q"_a, "guard"_a, "feature"_a = 0,
        "(gap, W (nv,), dW (nv, nv)) of a guard, or of the contact point of a pair with that feature, in engine "
        "coordinates: column k of dW is the derivative of W = d(gap)/dq along the k-th tangent vector.");
  m.def("contact_row_changes", &contact_row_changes, "scene"_a, "q"_a, "guard"_a, "t1"_a, "feature"_a = 0,
        "(rows n, t1, t2 of the relative velocity as columns (nv, 3), their derivatives as three matrices like dW of "
        "gap_hessian, those of the normal, of a's and of b's point (9, nv)), engine coordinates.");
}

}  // namespace contactvi

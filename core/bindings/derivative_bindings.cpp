// Derivatives of steps, in public coordinates.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include <tuple>

#include "base/error.hpp"
#include "bindings/expose.hpp"
#include "bindings/user_calls.hpp"
#include "model/scene.hpp"
#include "step/linearize.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

void need_state(const Tree& tree, const VecX& q, const VecX& x) {
  if (q.size() != tree.nq || x.size() != tree.nv) throw Error("expected shapes (nq,) and (nv,)");
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

std::tuple<VecX, VecX, Rows, Rows, VecX> linear_step(const Scene& s, const VecX& q, const VecX& x, bool momentum,
                                                     double h, const std::optional<VecX>& tau,
                                                     const std::optional<VecX>& target, double t, int order,
                                                     double tol) {
  need_state(s.tree, q, x);
  if (order < 2 || order > 2 * kMaxStages || order % 2 != 0) throw Error("order must be 2, 4, ... 16");
  const StateKind kind = momentum ? StateKind::kMomentum : StateKind::kVelocity;
  const LinearStep step = linearize_step(s.tree, q, x, kind, h, inputs_of(s.tree, t, tau, target), order / 2, tol);
  UserErrors::raise();
  return {step.q1, step.x1, Rows(step.A), Rows(step.B), step.h};
}

std::tuple<VecX, Rows, Rows> linear_forces(const Scene& s, const VecX& q, const VecX& v,
                                           const std::optional<VecX>& target, double t) {
  need_state(s.tree, q, v);
  const LinearForces forces = linearize_forces(s.tree, q, v, inputs_of(s.tree, t, std::nullopt, target));
  UserErrors::raise();
  return {forces.f, Rows(forces.f_q), Rows(forces.f_v)};
}

}  // namespace

void expose_derivatives(nb::module_& m) {
  m.def("linear_step", &linear_step, "scene"_a, "q"_a, "x"_a, "momentum"_a, "h"_a, "tau"_a = nb::none(),
        "target"_a = nb::none(), "t"_a = 0.0, "order"_a = 2, "tol"_a = 1e-12,
        "One smooth step and its derivatives: (q1, x1, A (2 nv, 2 nv), B (2 nv, nv), d(q1, x1)/dh (2 nv,)), x being "
        "the velocity or the momentum; target: references of the servos (2 nv,).");
  m.def("linear_forces", &linear_forces, "scene"_a, "q"_a, "v"_a, "target"_a = nb::none(), "t"_a = 0.0,
        "Forces of springs, dampers, servos and elements and their derivatives: (f (nv,), f_q, f_v (nv, nv)).");
}

}  // namespace contactvi

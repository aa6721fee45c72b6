// Derivatives of steps, in public coordinates.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include <tuple>

#include "base/error.hpp"
#include "bindings/expose.hpp"
#include "model/scene.hpp"
#include "step/linearize.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

std::tuple<VecX, VecX, Rows, Rows, VecX> linear_step(const Scene& s, const VecX& q, const VecX& x, bool momentum,
                                                     double h, const std::optional<VecX>& tau, double t, int order,
                                                     double tol) {
  const Tree& tree = s.tree;
  if (q.size() != tree.nq || x.size() != tree.nv) throw Error("expected shapes (nq,) and (nv,)");
  if (tau && tau->size() != tree.nv) throw Error("tau: expected shape (nv,)");
  if (order < 2 || order > 2 * kMaxStages || order % 2 != 0) throw Error("order must be 2, 4, ... 16");
  const StateKind kind = momentum ? StateKind::kMomentum : StateKind::kVelocity;
  LinearStep step = linearize_step(tree, q, x, kind, h, tau ? *tau : VecX(), t, order / 2, tol);
  return {step.q1, step.x1, Rows(step.A), Rows(step.B), step.h};
}

}  // namespace

void expose_derivatives(nb::module_& m) {
  m.def("linear_step", &linear_step, "scene"_a, "q"_a, "x"_a, "momentum"_a, "h"_a, "tau"_a = nb::none(), "t"_a = 0.0,
        "order"_a = 2, "tol"_a = 1e-12,
        "One smooth step and its derivatives: (q1, x1, A (2 nv, 2 nv), B (2 nv, nv), d(q1, x1)/dh (2 nv,)), x being "
        "the velocity or the momentum.");
}

}  // namespace contactvi

// States between the nodes of a run, from the polynomials of its steps.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>

#include "base/error.hpp"
#include "bindings/arrays.hpp"
#include "bindings/expose.hpp"
#include "model/coordinates.hpp"
#include "model/scene.hpp"
#include "step/integrator.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

struct Pieces {
  VecX t, h;
  Rows q, p, p1, rates;
};

// Sets the path of one segment and raises its degree by the velocities at its ends.
bool set_path(Integrator& integrator, const Pieces& pieces, Eigen::Index i, int stages, StepPath& path) {
  const Tree& tree = integrator.tree();
  const VecX q0 = pieces.q.row(i), p0 = pieces.p.row(i), p1 = pieces.p1.row(i), flat = pieces.rates.row(i);
  path.set(q0, pieces.h[i], Eigen::Map<const MatX>(flat.data(), tree.nv, stages));
  VecX v0(tree.nv), v1(tree.nv), q1(tree.nq);
  path.configuration(1.0, q1);
  if (!integrator.node_velocity(q0, p0, v0) || !integrator.node_velocity(q1, p1, v1)) return false;
  path.raise(v0, v1);
  return true;
}

constexpr double kAtNode = 1e-9;  // fraction of a segment; nearer to an end the polynomial is the node

// Finds the state at the fraction tau of a segment by a step from its start to there, which is as accurate as a node.
bool solve_to(Integrator& integrator, const StepPath& path, double tau, const VecX& p0, VecRef q, VecRef v) {
  if (tau < kAtNode || tau > 1.0 - kAtNode) return false;
  VecX p1(v.size());
  if (!integrator.solve_part(path, tau, path.q0(), p0, VecX())) return false;
  integrator.finish(q, p1);
  return integrator.node_velocity(q, p1, v);
}

std::tuple<Array2, Array2> dense(const Scene& s, const Dict& segments, const VecX& times, int order, bool exact) {
  const Pieces pieces{nb::cast<VecX>(segments["t"]), nb::cast<VecX>(segments["h"]),  nb::cast<Rows>(segments["q"]),
                      nb::cast<Rows>(segments["p"]), nb::cast<Rows>(segments["p1"]), nb::cast<Rows>(segments["rates"])};
  const Tree& tree = s.tree;
  const Eigen::Index n = pieces.t.size();
  const int stages = order / 2;
  if (n == 0 || stages < 1 || stages > kMaxStages || pieces.h.size() != n || pieces.q.rows() != n ||
      pieces.p.rows() != n || pieces.p1.rows() != n || pieces.rates.rows() != n || pieces.p.cols() != tree.nv ||
      pieces.p1.cols() != tree.nv || pieces.q.cols() != tree.nq || pieces.rates.cols() != tree.nv * stages)
    throw Error("the segments do not belong to this scene and order");
  Integrator integrator(tree, stages, 1e-15, 60);
  StepPath path(tree, stages);
  Rows q(times.size(), tree.nq), v(times.size(), tree.nv);
  VecX qi(tree.nq), vi(tree.nv), p0(tree.nv);
  Eigen::Index at = -1;
  for (Eigen::Index k = 0; k < times.size(); ++k) {
    const double* end = pieces.t.data() + n;
    Eigen::Index i = std::max<Eigen::Index>(0, std::upper_bound(pieces.t.data(), end, times[k]) - pieces.t.data() - 1);
    if (i != at && !set_path(integrator, pieces, i, stages, path))
      throw Error("the mass matrix is not positive definite");
    at = i;
    const double tau = std::clamp((times[k] - pieces.t[i]) / pieces.h[i], 0.0, 1.0);
    p0 = pieces.p.row(i);
    if (!exact || !solve_to(integrator, path, tau, p0, qi, vi)) {
      path.configuration(tau, qi);
      path.velocity(tau, vi);
    }
    engine_to_public(tree, qi, vi);
    q.row(k) = qi;
    v.row(k) = vi;
  }
  return {hand_over(std::move(q)), hand_over(std::move(v))};
}

}  // namespace

void expose_dense(nb::module_& m) {
  m.def("dense", &dense, "scene"_a, "segments"_a, "times"_a, "order"_a, "exact"_a = false,
        "States (q (N, nq), v (N, nv)) at times (N,) from the segments of a run: from their polynomials, or exact, by "
        "the steps of the lengths in between (of runs without inputs).");
}

}  // namespace contactvi

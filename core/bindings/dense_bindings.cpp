// States between the nodes of a run, from the polynomials of its steps.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <array>
#include <limits>

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

constexpr int kMostParts = 16, kMostIterations = 100;
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

// Advances a state (engine coordinates) by h in parts, in the fewest powers of two up to kMostParts that are solved.
bool solve_in_parts(Integrator& integrator, double h, VecX& q, VecX& p) {
  const VecX q0 = q, p0 = p;
  VecX q1(q.size()), p1(p.size());
  for (int parts = 1; parts <= kMostParts; parts *= 2) {
    q = q0;
    p = p0;
    int solved = 0;
    for (integrator.forget(); solved < parts && integrator.solve(q, p, h / parts, VecX()); ++solved) {
      integrator.finish(q1, p1);
      q = q1;
      p = p1;
      integrator.forget();
    }
    if (solved == parts) return true;
  }
  return false;
}

std::tuple<Array2, Array2> halved_steps(const Scene& s, const Rows& q, const Rows& p, const VecX& h, double tol,
                                        int order) {
  const Tree& tree = s.tree;
  if (order < 2 || order > 2 * kMaxStages || q.cols() != tree.nq || p.cols() != tree.nv || p.rows() != q.rows() ||
      h.size() != q.rows())
    throw Error("expected starts (N, nq), (N, nv) and lengths (N,)");
  Integrator integrator(tree, order / 2, tol, kMostIterations);
  std::array<Rows, 2> ends{Rows(q.rows(), tree.nq), Rows(q.rows(), tree.nq)};
  for (Eigen::Index k = 0; k < q.rows(); ++k) {
    for (int parts : {1, 2}) {
      VecX qi = q.row(k), pi = p.row(k);
      bool solved = true;
      for (int part = 0; part < parts; ++part) solved = solved && solve_in_parts(integrator, h[k] / parts, qi, pi);
      if (!solved) qi.setConstant(std::numeric_limits<double>::quiet_NaN());
      engine_to_public(tree, qi, pi);
      ends[static_cast<std::size_t>(parts - 1)].row(k) = qi;
    }
  }
  return {hand_over(std::move(ends[0])), hand_over(std::move(ends[1]))};
}

}  // namespace

void expose_dense(nb::module_& m) {
  m.def("dense", &dense, "scene"_a, "segments"_a, "times"_a, "order"_a, "exact"_a = false,
        "States (q (N, nq), v (N, nv)) at times (N,) from the segments of a run: from their polynomials, or exact, by "
        "the steps of the lengths in between (of runs without inputs).");
  m.def(
      "halved_steps", &halved_steps, "scene"_a, "q"_a, "p"_a, "h"_a, "tol"_a, "order"_a,
      "Configurations (N, nq) after smooth steps of the lengths h (N,), each in one piece, and each in two halves, from"
      " q (N, nq) and p (N, nv) in the engine's coordinates; NaN where they are not solved.");
}

}  // namespace contactvi

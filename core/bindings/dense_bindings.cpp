// States between the nodes of a run, from the polynomials of its steps.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/tuple.h>

#include <utility>

#include "base/error.hpp"
#include "bindings/arrays.hpp"
#include "bindings/expose.hpp"
#include "model/coordinates.hpp"
#include "model/scene.hpp"
#include "step/segment_paths.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

constexpr int kMostIterations = 60;

std::tuple<Array2, Array2> dense(const Scene& s, const Dict& segments, const VecX& times, int order, double tol,
                                 bool exact, bool momenta) {
  const Tree& tree = s.tree;
  const VecX t = nb::cast<VecX>(segments["t"]), h = nb::cast<VecX>(segments["h"]),
             persistent = nb::cast<VecX>(segments["persistent"]);
  const Rows q = nb::cast<Rows>(segments["q"]), p = nb::cast<Rows>(segments["p"]), p1 = nb::cast<Rows>(segments["p1"]),
             rates = nb::cast<Rows>(segments["rates"]);
  const Eigen::Index n = t.size();
  const int stages = order / 2;
  if (n == 0 || stages < 1 || stages > kMaxStages || h.size() != n || q.rows() != n || p.rows() != n ||
      p1.rows() != n || rates.rows() != n || persistent.size() != n || p.cols() != tree.nv || p1.cols() != tree.nv ||
      q.cols() != tree.nq || rates.cols() != tree.nv * stages)
    throw Error("the segments do not belong to this scene and order");
  SegmentPaths paths(tree, stages,
                     {n, t.data(), h.data(), q.data(), p.data(), p1.data(), rates.data(), persistent.data()});
  Integrator integrator(tree, stages, tol, kMostIterations, true);
  Rows found_q(times.size(), tree.nq), found_v(times.size(), tree.nv);
  VecX qi(tree.nq), vi(tree.nv);
  for (Eigen::Index k = 0; k < times.size(); ++k) {
    if (!(momenta ? paths.momentum(times[k], tol, integrator, qi, vi)
          : exact ? paths.state(times[k], tol, integrator, qi, vi)
                  : paths.state(times[k], integrator, qi, vi)))
      throw Error("the mass matrix is not positive definite");
    engine_to_public(tree, qi, vi);
    found_q.row(k) = qi;
    found_v.row(k) = vi;
  }
  return {hand_over(std::move(found_q)), hand_over(std::move(found_v))};
}

}  // namespace

void expose_dense(nb::module_& m) {
  m.def("dense", &dense, "scene"_a, "segments"_a, "times"_a, "order"_a, "tol"_a, "exact"_a = false, "momenta"_a = false,
        "States (q (N, nq), v (N, nv)) at times (N,) from the segments of a run: from their polynomials, or exact, by "
        "steps of the lengths in between, solved to tol (of runs without inputs, and not where contacts persist). "
        "momenta: p instead of v, exact.");
}

}  // namespace contactvi

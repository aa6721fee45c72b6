// The stage kernel: which build of it is used, and what it costs.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <chrono>
#include <limits>
#include <string>

#include "base/error.hpp"
#include "bindings/expose.hpp"
#include "model/coordinates.hpp"
#include "model/scene.hpp"
#include "step/column_solver.hpp"
#include "step/integrator.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

std::vector<std::string> names() {
  std::vector<std::string> all;
  for (const char* name : instruction_sets()) all.push_back(name);
  return all;
}

std::string use(const std::string& name) {
  if (!name.empty() && !set_instruction_set(name.c_str())) throw Error("this processor has no instruction set " + name);
  return instruction_set();
}

template <class Call>
double fastest(int calls, int repeats, Call call) {
  double best = std::numeric_limits<double>::infinity();
  for (int r = 0; r < repeats; ++r) {
    const auto start = std::chrono::steady_clock::now();
    for (int k = 0; k < calls; ++k) call();
    best = std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count() / calls);
  }
  return best;
}

// The stages at (q, v) of a step of length h [s], as a run solves them.
void set_stages(const Scene& s, const VecX& q, const VecX& v, double h, Stages& work) {
  VecX w = v;
  public_to_engine(s.tree, q, w);
  work.begin(q, VecX::Ones(s.tree.nv), h, VecX());
  const int S = work.padded();
  for (int d = 0; d < s.tree.nv; ++d)
    for (int i = 0; i < S; ++i) {
      work.v()[d * S + i] = w[d] * (1.0 + 0.01 * i);
      work.X()[d * S + i] = 0.01 * i;
    }
}

using Seconds = nb::typed<nb::dict, nb::str, double>;

// Seconds per stage of each part of the kernel, at stages a little apart from each other.
Seconds kernel_seconds(const Scene& s, const VecX& q, const VecX& v, int stages, const std::string& set, int calls,
                       int repeats) {
  const Tree& tree = s.tree;
  if (q.size() != tree.nq || v.size() != tree.nv) throw Error("expected shapes (nq,) and (nv,)");
  if (stages < 1 || stages > kMaxStages) throw Error("expected 1 to 8 stages");
  const std::string before = instruction_set();
  if (!set.empty()) use(set);
  const FlatModel model(tree);
  Stages work(tree, model, stages);
  set_instruction_set(before.c_str());
  set_stages(s, q, v, 1e-3, work);
  work.evaluate();
  work.factor();
  auto load = [&] {
    for (int i = 0; i < tree.nv * work.padded(); ++i) work.dv()[i] = 1.0;
  };
  Seconds d;
  d["evaluate"] = fastest(calls, repeats, [&] { work.evaluate(); }) / stages;
  d["factor"] = fastest(calls, repeats, [&] { work.factor(); }) / stages;
  d["solve"] = fastest(calls, repeats, [&] { load(), work.solve(); }) / stages;
  // f(q, p) = (M^-1 p, dT/dq - dV/dq) from nothing: place, factor, solve, evaluate.
  d["f"] =
      fastest(calls, repeats, [&] { work.place(), work.factor(), load(), work.solve(), work.evaluate(); }) / stages;
  d["sweep"] = fastest(calls, repeats, [&] { work.iterate(kLaneKeepVelocity); }) / stages;
  return d;
}

// So many iterations of the kernel on the stage equations, the first ones with a factor, and nothing else.
void iterate_kernel(const Scene& s, const VecX& q, const VecX& v, int stages, long iterations, long factors) {
  if (q.size() != s.tree.nq || v.size() != s.tree.nv) throw Error("expected shapes (nq,) and (nv,)");
  if (stages < 1 || stages > kMaxStages) throw Error("expected 1 to 8 stages");
  const FlatModel model(s.tree);
  Stages work(s.tree, model, stages);
  set_stages(s, q, v, 1e-3, work);
  for (long k = 0; k < iterations; ++k) work.iterate(kLaneKeepVelocity | (k < factors ? kLaneFactor | kLaneFirst : 0));
}

// M(q)^-1 X of the engine's mass matrix, all columns side by side.
MatX solve_masses(const Scene& s, const VecX& q, MatX X) {
  if (q.size() != s.tree.nq || X.rows() != s.tree.nv) throw Error("expected shapes (nq,) and (nv, m)");
  const FlatModel model(s.tree);
  Stages node(s.tree, model, 1);
  node.at(q);
  node.place();
  node.factor();
  ColumnSolver(s.tree, model).solve(node, X);
  return X;
}

}  // namespace

void expose_kernel(nb::module_& m) {
  m.def("instruction_sets", &names, "Builds of the stage kernel that this processor runs, best last.");
  m.def("instruction_set", &use, "name"_a = "",
        "Set (given a name) and return the one that engines made from now on use. The digits do not depend on it.");
  m.def("kernel_seconds", &kernel_seconds, "scene"_a, "q"_a, "v"_a, "stages"_a, "instruction_set"_a = "",
        "calls"_a = 2000, "repeats"_a = 5,
        "Seconds per stage of evaluate, factor, solve, f(q, p) and sweep, fastest of several blocks; for benchmarks.");
  m.def("iterate_kernel", &iterate_kernel, "scene"_a, "q"_a, "v"_a, "stages"_a, "iterations"_a, "factors"_a,
        "Make so many stage iterations at (q, v), the first of them with a factor; for benchmarks.");
  m.def("solve_masses", &solve_masses, "scene"_a, "q"_a, "right"_a,
        "M(q)^-1 times the columns of right, shape (nv, m), in engine coordinates, for tests.");
}

}  // namespace contactvi

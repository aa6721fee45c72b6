// Batch: many runs in threads of the engine, without the interpreter lock; results as arrays and, by run, as dicts.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <limits>
#include <memory>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include "base/worker_threads.hpp"
#include "bindings/contact_results.hpp"
#include "bindings/expose.hpp"
#include "bindings/kept_state.hpp"
#include "bindings/run_results.hpp"
#include "model/coordinates.hpp"
#include "run/batch.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

using BatchProgress = nb::typed<nb::callable, nb::object(std::size_t)>;

// The inputs of runs: the same matrix for those that were given the same array.
struct Inputs {
  std::shared_ptr<const MatX> values;
};

void add(Batch& batch, const Scene& scene, const VecX& q, const VecX& v, const Inputs* tau, const Inputs* target,
         const std::optional<VecX>& changes) {
  if (q.size() != scene.tree.nq || v.size() != scene.tree.nv) throw Error("expected shapes (nq,) and (nv,)");
  if (scene.tree.elements.functions) throw Error("functions of the user need the interpreter lock");
  if (tau && tau->values->cols() != scene.tree.nv) throw Error("tau: expected shape (steps, nv)");
  if (target && target->values->cols() != 2 * scene.tree.nv) throw Error("target: expected shape (steps, 2 nv)");
  if (changes && changes->size() < batch.changes().columns()) throw Error("changes: expected a number for each place");
  VecX w = v;
  public_to_engine(scene.tree, q, w);
  batch.add({&scene, q, w, tau ? tau->values : nullptr, target ? target->values : nullptr, changes.value_or(VecX())});
}

using Places = std::vector<std::tuple<SceneNumber, int, int>>;

void set_changes(Batch& batch, const Scene& scene, const Places& places) {
  SceneChanges changes;
  for (const auto& [kind, index, column] : places) changes.add(scene, kind, index, column);
  batch.set_changes(std::move(changes));
}

void run(Batch& batch, int threads, const std::optional<BatchProgress>& progress) {
  if (threads < 1) throw Error("threads must be >= 1");
  std::optional<nb::python_error> error;
  const auto poll = [&](std::size_t made) {
    const nb::gil_scoped_acquire gil;
    if (PyErr_CheckSignals() != 0) {
      error.emplace();
      return false;
    }
    try {
      if (progress) (*progress)(made);
    } catch (nb::python_error& raised) {
      error.emplace(raised);
      return false;
    }
    return true;
  };
  {
    nb::gil_scoped_release release;
    batch.run(threads, poll);
  }
  if (error) throw nb::python_error(*error);
}

BatchOutcome& outcome(Batch& batch, std::size_t k) {
  if (k >= batch.size()) throw Error("there is no such run");
  return batch.outcome(k);
}

template <class Number>
nb::ndarray<nb::numpy, Number, nb::ndim<1>> column(Batch& batch, Number (*of)(const BatchOutcome&)) {
  std::vector<Number> values(batch.size());
  for (std::size_t k = 0; k < values.size(); ++k) values[k] = of(batch.outcome(k));
  const std::size_t n = values.size();
  return hand_over_as<nb::ndarray<nb::numpy, Number, nb::ndim<1>>>(std::move(values), {n});
}

using Array3 = nb::ndarray<nb::numpy, double, nb::ndim<3>>;

// Numbers that nobody has set yet: the memory is first touched where they are.
struct Unset {
  explicit Unset(std::size_t count) : numbers(new double[count]) {}
  double* data() { return numbers.get(); }
  std::unique_ptr<double[]> numbers;
};

// The rows of all runs, of `width` numbers, with NaN after the end of the shorter ones; they are moved from. As many
// threads as made the runs copy them.
Array3 padded(Batch& batch, std::vector<double> BatchOutcome::* rows, std::size_t nodes, std::size_t width) {
  const std::size_t size = nodes * width;
  Unset all(batch.size() * size);
  {
    nb::gil_scoped_release release;
    in_parallel(
        static_cast<int>(batch.size()),
        [&](int k) {
          const std::vector<double> own = std::exchange(batch.outcome(static_cast<std::size_t>(k)).*rows, {});
          double* const to = all.data() + static_cast<std::size_t>(k) * size;
          std::fill(std::copy(own.begin(), own.end(), to), to + size, std::numeric_limits<double>::quiet_NaN());
        },
        batch.threads());
  }
  return hand_over_as<Array3>(std::move(all), {batch.size(), nodes, width});
}

Dict table(Batch& batch, std::size_t nq, std::size_t nv) {
  std::size_t nodes = 1;
  for (std::size_t k = 0; k < batch.size(); ++k) nodes = std::max(nodes, batch.outcome(k).t.size());
  Dict d;
  d["nodes"] = column<std::int64_t>(batch, [](const BatchOutcome& o) { return std::int64_t(o.t.size()); });
  d["code"] = column<std::int64_t>(batch, [](const BatchOutcome& o) {
    return std::int64_t(static_cast<int>(o.made ? o.status.code : StatusCode::kInterrupted));
  });
  d["time"] = column<double>(batch, [](const BatchOutcome& o) { return o.status.time; });
  d["impacts"] = column<std::int64_t>(batch, [](const BatchOutcome& o) { return std::int64_t(o.impacts); });
  d["dense_steps"] = column<std::int64_t>(batch, [](const BatchOutcome& o) { return std::int64_t(o.dense_steps); });
  d["seconds"] = column<double>(batch, [](const BatchOutcome& o) { return o.seconds; });
  d["t"] = padded(batch, &BatchOutcome::t, nodes, 1);
  d["q"] = padded(batch, &BatchOutcome::q, nodes, nq);
  d["v"] = padded(batch, &BatchOutcome::v, nodes, nv);
  return d;
}

// The fields of the status of a run and whether its start was refused; raises what the engine refused.
Dict status(Batch& batch, std::size_t k) {
  const BatchOutcome& o = outcome(batch, k);
  if (o.failure) std::rethrow_exception(o.failure);
  Dict d;
  add_status(*batch.start(k).scene, o.status, d);
  d["refused"] = !o.start.ok();
  d["massless"] = o.massless;
  return d;
}

// The momenta at the start and at the end of a run that was kept, the configuration there, and the results of the run.
nb::typed<nb::tuple, Array1, Array1, Array1, Dict> result(Batch& batch, std::size_t k) {
  BatchOutcome& o = outcome(batch, k);
  const Scene& s = *batch.start(k).scene;
  KeptContactSteps kept{std::move(o.contact_steps), std::move(o.impact_blocks), std::move(o.kept_dense_steps),
                        std::move(o.held_steps)};
  const VecX start_p = public_momentum(s.tree, batch.start(k).q, o.start_p);
  const VecX end_p = public_momentum(s.tree, o.state.q, o.state.p);
  Dict d = run_results(s, batch.options(), o.recording, o.state, o.counters, std::move(kept), o.status, o.seconds);
  d["error"] = nb::none();
  return nb::make_tuple(hand_over(VecX(start_p)), hand_over(VecX(o.state.q)), hand_over(VecX(end_p)), d);
}

}  // namespace

void expose_batch(nb::module_& m) {
  nb::enum_<BatchKeep>(m, "BatchKeep", "What is kept of the runs of a batch.")
      .value("ENDS", BatchKeep::kEnds)
      .value("NODES", BatchKeep::kNodes)
      .value("RUNS", BatchKeep::kRuns);
  nb::enum_<SceneNumber>(m, "SceneNumber", "What a number of a scene is that differs from run to run.")
      .value("GRAVITY", SceneNumber::kGravity)
      .value("RESTITUTION", SceneNumber::kRestitution)
      .value("FRICTION", SceneNumber::kFriction)
      .value("LIMIT_RESTITUTION", SceneNumber::kLimitRestitution)
      .value("STIFFNESS", SceneNumber::kStiffness)
      .value("REST", SceneNumber::kRest)
      .value("ARMATURE", SceneNumber::kArmature)
      .value("DAMPING", SceneNumber::kDamping)
      .value("KP", SceneNumber::kKp)
      .value("KD", SceneNumber::kKd)
      .value("BODY", SceneNumber::kBody);
  nb::class_<Inputs>(m, "BatchInputs", "Inputs of the steps of a run, which several runs may share.")
      .def(
          "__init__", [](Inputs* self, const Rows& rows) { new (self) Inputs{std::make_shared<const MatX>(rows)}; },
          "rows"_a);
  nb::class_<Batch>(m, "Batch", "Many runs with steps of one length, in several threads.")
      .def(nb::init<const SimulatorOptions&, long, long, BatchKeep, double>(), "options"_a, "steps"_a, "record_every"_a,
           "keep"_a, "most_lost"_a)
      .def("set_changes", &set_changes, "scene"_a, "places"_a,
           "Tell what the numbers of the rows of changes are: (kind, index in the scene, column).")
      .def(
          "set_start", [](Batch& batch, const Kept& kept) { batch.set_start(kept.snapshot); }, "snapshot"_a,
          "Let all runs go on from a snapshot of their scene.")
      .def("add", &add, "scene"_a, "q"_a, "v"_a, "tau"_a = nb::none(), "target"_a = nb::none(),
           "changes"_a = nb::none(), nb::keep_alive<1, 2>(),
           "Add a run from (q, v), with a row of numbers that differ from those of the scene; the scene calls no "
           "function of the user.")
      .def("run", &run, "threads"_a, "progress"_a = nb::none(),
           "Make all runs without the interpreter lock; progress(runs made) is called now and then.")
      .def_prop_ro("shared_iterations", &Batch::shared_iterations,
                   "Stage iterations that runs have made together, each counted once for every run in it.")
      .def("table", &table, "nq"_a, "nv"_a, "Return states and counts of all runs as arrays, once.")
      .def("status", &status, "k"_a, "Return the fields of the status of a run.")
      .def("result", &result, "k"_a, "Return momenta at start and end, q at the end, and the results of a run, once.");
}

}  // namespace contactvi

// Simulator: the event loop without the interpreter lock, results as arrays in public coordinates.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include "base/worker_threads.hpp"
#include "bindings/arrays.hpp"
#include "bindings/contact_results.hpp"
#include "bindings/expose.hpp"
#include "bindings/kept_state.hpp"
#include "bindings/progress.hpp"
#include "bindings/run_results.hpp"
#include "bindings/user_calls.hpp"
#include "model/coordinates.hpp"
#include "run/saved_bytes.hpp"
#include "run/stepped_world.hpp"
#include "sensitivity/contact_step_numbers.hpp"
#include "step/lost_velocity.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

// What the world has recorded and where it stands after it.
Dict results(World& sim, SteppedWorld::Record record) {
  KeptContactSteps kept{sim.take_contact_steps(), sim.take_impact_blocks(), sim.take_dense_steps(),
                        sim.take_held_steps()};
  // The error that interrupted the run is handed over as data, so that the partial result is not lost with it.
  nb::object error = nb::none();
  if (UserErrors::any()) error = UserErrors::take();
  Dict d = run_results(sim.scene(), sim.options(), record.recording, sim.state(), sim.counters(), std::move(kept),
                       record.status, record.seconds);
  d["error"] = error;
  d["forced"] = record.forced;
  return d;
}

template <class Run>
Dict run(SteppedWorld& sim, const std::optional<ProgressCallback>& progress, Run call) {
  SteppedWorld::Record record;
  const Progress callback = wrapped(progress);
  sim.forget_steps();
  const auto start = std::chrono::steady_clock::now();
  {
    nb::gil_scoped_release release;
    record.status = call(callback, record.recording);
  }
  record.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return results(sim, std::move(record));
}

// The numbers of a C-contiguous array of `size` doubles in one row. False: it is something else; None has no numbers.
bool numbers_of_array(nb::handle array, std::size_t size, const double*& numbers) {
  numbers = nullptr;
  if (array.is_none()) return true;
  nb::ndarray<const double, nb::c_contig, nb::device::cpu> given;
  if (!nb::try_cast(array, given, false) || given.size() != size || given.ndim() == 0) return false;
  numbers = given.data();  // of the array, which the caller holds
  return given.shape(given.ndim() - 1) == size;
}

// The time after one more step, which is recorded for take(). None: nothing was done, because another call is under way
// or an input is not a plain array of ordinary numbers. False: the step was made and take() has something to look at.
nb::object step_world(SteppedWorld& sim, nb::handle tau, nb::handle target) {
  static const Progress signals = wrapped(std::nullopt);
  const std::size_t nv = static_cast<std::size_t>(sim.scene().tree.nv);
  const double *force = nullptr, *reference = nullptr;
  if (sim.stepping() || !numbers_of_array(tau, nv, force) || !numbers_of_array(target, 2 * nv, reference) ||
      !sim.set_step_inputs(force, reference))
    return nb::none();
  SteppedWorld::Outcome outcome;
  {
    nb::gil_scoped_release release;
    outcome = sim.step_once(signals);
  }
  if (outcome != SteppedWorld::Outcome::kOrdinary || UserErrors::any()) return nb::bool_(false);
  return nb::float_(sim.time());
}

// Of each simulator how many ordinary steps it has made with its rows of the inputs; where these are fewer, a further
// one was made, and take() has something to look at.
std::vector<long> step_together(const std::vector<SteppedWorld*>& sims, long steps, const std::optional<Rows>& tau,
                                const std::optional<Rows>& target, int threads) {
  if (threads < 1) throw Error("threads must be >= 1");
  const int count = static_cast<int>(sims.size());
  for (int k = 0; k < count; ++k) {
    const Tree& tree = sims[k]->scene().tree;
    if (tree.elements.functions) throw Error("functions of the user need the interpreter lock");
    if (tau && (tau->rows() != count || tau->cols() != tree.nv)) throw Error("tau: expected shape (n, nv)");
    if (target && (target->rows() != count || target->cols() != 2 * tree.nv))
      throw Error("target: expected shape (n, 2 nv)");
    if (std::count(sims.begin(), sims.end(), sims[k]) > 1) throw Error("expected different simulators");
    if (sims[k]->stepping() ||
        !sims[k]->set_step_inputs(tau ? tau->row(k).data() : nullptr, target ? target->row(k).data() : nullptr))
      throw Error("expected simulators that are not in use, and forces of ordinary size");
  }
  std::vector<long> made(sims.size());
  {
    nb::gil_scoped_release release;
    const Progress none = [](double, long) { return true; };
    in_parallel(count, [&](int k) { made[k] = sims[k]->step_while_ordinary(steps, none); }, threads);
  }
  return made;
}

nb::object take(SteppedWorld& sim) {
  if (sim.stepping() || !sim.has_record()) return nb::none();
  return results(sim, sim.take_record());
}

nb::object before(const SteppedWorld& sim) {
  const SteppedWorld::Before& at = sim.before();
  if (!at.known) return nb::none();
  return nb::make_tuple(at.time, hand_over(VecX(at.q)), hand_over(public_momentum(sim.scene().tree, at.q, at.p)));
}

Dict advance(SteppedWorld& sim, long steps, const std::optional<Rows>& tau, long record_every,
             const std::optional<ProgressCallback>& progress, const std::optional<Rows>& target) {
  if (tau && (tau->rows() != steps || tau->cols() != sim.scene().tree.nv))
    throw Error("tau: expected shape (steps, nv)");
  if (target && (target->rows() != steps || target->cols() != 2 * sim.scene().tree.nv))
    throw Error("target: expected shape (steps, 2 nv)");
  if (steps < 0 || record_every < 1) throw Error("steps must be >= 0 and record_every >= 1");
  const MatX force = tau ? MatX(*tau) : MatX(), reference = target ? MatX(*target) : MatX();
  return run(sim, progress, [&](const Progress& callback, Recording& recording) {
    return sim.advance(steps, force, reference, record_every, callback, recording);
  });
}

Dict reset(SteppedWorld& sim, const VecX& q, const VecX& v, double t) {
  const Scene& s = sim.scene();
  if (q.size() != s.tree.nq || v.size() != s.tree.nv) throw Error("expected shapes (nq,) and (nv,)");
  VecX w = v;
  public_to_engine(s.tree, q, w);
  Dict d;
  sim.forget_steps();
  const Status status = sim.reset(q, w, t);
  UserErrors::raise();
  add_status(s, status, d);
  return d;
}

Array1 current_velocity(SteppedWorld& sim) {
  const Tree& tree = sim.scene().tree;
  Integrator integrator(tree, 1, 1e-12, 1);  // of its own: callbacks read the velocity in the middle of a step
  VecX v(tree.nv);
  if (!integrator.node_velocity(sim.q(), sim.p(), v)) throw Error("the mass matrix is not positive definite");
  engine_to_public(tree, sim.q(), v);
  return hand_over(std::move(v));
}

// A simulator keeps its scene alive. The garbage collector has to know, because functions of the user that the scene
// calls may hold the simulator.
int traverse(PyObject* self, visitproc visit, void* arg) {
  Py_VISIT(Py_TYPE(self));
  if (!nb::inst_ready(self)) return 0;
  const nb::object scene = nb::find(nb::inst_ptr<SteppedWorld>(self)->scene());
  Py_VISIT(scene.ptr());
  return 0;
}

PyType_Slot simulator_slots[] = {{Py_tp_traverse, reinterpret_cast<void*>(&traverse)}, {0, nullptr}};

void set_order(SimulatorOptions& options, int order) {
  if (order < 2 || order > 2 * kMaxStages || order % 2 != 0) throw Error("expected an even order from 2 to 16");
  options.stages = order / 2;
}

void expose_options(nb::module_& m) {
  nb::class_<SimulatorOptions>(m, "SimulatorOptions", "Settings of a simulator; each has a default.")
      .def(nb::init<>())
      .def_rw("dt", &SimulatorOptions::dt, "Step length [s].")
      .def_rw("tol", &SimulatorOptions::tol, "Tolerance on the residual of the stage equations, relative.")
      .def_rw("impact", &SimulatorOptions::impact)
      .def_rw("mhc_reference", &SimulatorOptions::mhc_reference)
      .def_rw("max_iterations", &SimulatorOptions::max_iterations, "Stage iterations per attempt at a step.")
      .def_rw("max_impacts_per_step", &SimulatorOptions::max_impacts_per_step)
      .def_prop_rw(
          "order", [](const SimulatorOptions& options) { return 2 * options.stages; }, &set_order,
          "Order 2s of the integrator with s Gauss stages.")
      .def_rw("dense", &SimulatorOptions::dense, "Whether the polynomials of the steps are kept.")
      .def_rw("dt_contact", &SimulatorOptions::dt_contact, "Longest step with persistent contacts [s]; 0: dt.")
      .def_rw("end_at_zeno", &SimulatorOptions::end_at_zeno,
              "Whether a run ends where impacts accumulate, instead of going on with a persistent contact.")
      .def_rw("stiff_support", &SimulatorOptions::stiff_support,
              "Whether persistent contacts take part in an impact as rigid supports.")
      .def_rw("contact_points", &SimulatorOptions::contact_points, "Largest number of points of a pair.")
      .def_rw("record_contacts", &SimulatorOptions::record_contacts)
      .def_rw("gradient", &SimulatorOptions::gradient, "Whether contact steps are kept for derivatives; with dense.")
      .def_rw("islands", &SimulatorOptions::islands, "Whether islands are advanced one by one where that is possible.")
      .def_rw("threads", &SimulatorOptions::threads,
              "Threads that advance islands side by side; results do not depend on it.")
      .def_rw("contact_steps", &SimulatorOptions::contact_steps);
}

}  // namespace

void expose_simulator(nb::module_& m) {
  expose_options(m);
  nb::class_<KeptContactSteps>(m, "KeptContactSteps",
                               "The contact steps, dense ones too, of a call, as their derivatives need them.")
      .def(
          "__init__",
          [](KeptContactSteps* kept, const Scene& scene, const std::array<VecX, 6>& numbers) {
            const auto& [steps, blocks, dense, held, laws, held_laws] = numbers;
            new (kept) KeptContactSteps{contact_steps_of(scene, steps, laws), impact_blocks_of(scene, blocks),
                                        dense_steps_of(scene, dense), held_steps_of(scene, held, held_laws)};
          },
          "scene"_a, "numbers"_a, "From what numbers() returns.")
      .def(
          "numbers",
          [](const KeptContactSteps& kept) {
            return std::make_tuple(hand_over(numbers_of(kept.steps)), hand_over(numbers_of(kept.blocks)),
                                   hand_over(numbers_of(kept.dense)), hand_over(numbers_of(kept.held)),
                                   hand_over(law_numbers_of(kept.steps)), hand_over(law_numbers_of(kept.held)));
          },
          "Return the contact steps, impacts of several points, dense steps and smooth steps with rows as numbers, for "
          "files, and of the first and the last what their laws of contact need.");
  expose_still_rows(m);
  nb::class_<Kept>(m, "Snapshot", "All that the rest of a run depends on.")
      .def(
          "__init__",
          [](Kept* kept, const Scene& scene, nb::bytes bytes) {
            new (kept) Kept{saved_of(scene, {bytes.c_str(), bytes.size()}), &scene};
          },
          "scene"_a, "bytes"_a, nb::keep_alive<1, 2>(),
          "From what to_bytes() of one of this scene has returned, in this process or in another one.")
      .def(
          "to_bytes",
          [](const Kept& kept) {
            const std::string bytes = bytes_of(*kept.scene, *kept.snapshot);
            return nb::bytes(bytes.data(), bytes.size());
          },
          "Return it as bytes, for this version of the engine.");
  nb::class_<SteppedWorld> simulator(m, "Simulator", nb::type_slots(simulator_slots));
  expose_kept_runs(m, simulator);
  expose_posed_problems(simulator);
  simulator.def(nb::init<const Scene&, const SimulatorOptions&>(), "scene"_a, "options"_a, nb::keep_alive<1, 2>())
      .def("reset", &reset, "q"_a, "v"_a, "t"_a = 0.0,
           "Put the system to (q, v) at t [s]; return the fields of the status.")
      .def(
          "lost_velocity",
          [](SteppedWorld& sim, const VecX& q) {
            if (q.size() != sim.scene().tree.nq) throw Error("expected shape (nq,)");
            const LostVelocity lost = lost_velocity(sim.equations(), q);
            return std::make_pair(lost.dof, lost.share);
          },
          "q"_a, "As Scene.lost_velocity, between two calls.")
      .def("advance", &advance, "steps"_a, "tau"_a = nb::none(), "record_every"_a = 1, "progress"_a = nb::none(),
           "target"_a = nb::none(),
           "Make steps without the interpreter lock; return nodes, events, statistics and status.")
      .def("step", &step_world, "tau"_a = nb::none(), "target"_a = nb::none(),
           "Make one step, recorded for take(); return the time [s]. None: not made, with these inputs or now. False: "
           "made, and take() is to be looked at.")
      .def("take", &take, "Return what step() has recorded since the last take(), as advance() does; None: nothing.")
      .def("limit_record", &SteppedWorld::limit_record, "nodes"_a,
           "Set how many nodes step() records before it returns False; 0: nothing of the step before is kept.")
      .def_prop_ro("before", &before, "t, q and p at the start of the last step(); None after another call.")
      .def(
          "save", [](SteppedWorld& sim) { return Kept{sim.save(), &sim.scene()}; }, "Return a snapshot to go back to.")
      .def(
          "load",
          [](SteppedWorld& sim, const Kept& kept) {
            if (kept.scene != &sim.scene()) throw Error("the snapshot is of another scene");
            sim.forget_steps();
            sim.restore(*kept.snapshot);
          },
          "snapshot"_a, "Go back to a snapshot; what follows is equal to the bit.")
      .def_prop_ro(
          "islands", [](const SteppedWorld& sim) { return sim.islands(); },
          "Number of islands now; 0 where all bodies are advanced together.")
      .def_prop_ro("t", [](const SteppedWorld& sim) { return sim.time(); })
      .def_prop_ro(
          "q", [](const SteppedWorld& sim) { return hand_over(VecX(sim.q())); }, nb::rv_policy::automatic)
      .def_prop_ro(
          "p", [](const SteppedWorld& sim) { return hand_over(public_momentum(sim.scene().tree, sim.q(), sim.p())); },
          nb::rv_policy::automatic)
      .def_prop_ro("v", &current_velocity, nb::rv_policy::automatic);
  m.def(
      "step_together", &step_together, "simulators"_a, "steps"_a, "tau"_a = nb::none(), "target"_a = nb::none(),
      "threads"_a = 1,
      "Make steps of several simulators in threads, without the interpreter lock, each with a row of tau (n, nv) and of"
      " target (n, 2 nv); return how many ordinary steps each has made. Where these are fewer than `steps` a further"
      " one was made, and take() is to be looked at.");
}

}  // namespace contactvi

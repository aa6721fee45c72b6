// Runs that are kept in the engine, to be compared and, one of them, handed over.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include <chrono>
#include <limits>
#include <memory>
#include <optional>
#include <utility>
#include <variant>

#include "bindings/arrays.hpp"
#include "bindings/expose.hpp"
#include "bindings/kept_run.hpp"
#include "bindings/progress.hpp"
#include "bindings/run_results.hpp"
#include "bindings/user_calls.hpp"
#include "run/run_comparison.hpp"
#include "run/stepped_world.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

// The run, and the error of a callback or a function of the user that ended it.
using Outcome = nb::typed<nb::tuple, OwnRun, nb::object>;

// References of servos, (2 nv,) at a time [s]; one row of them, where they are constant; or none.
using ReferencesOfTime = nb::typed<nb::callable, VecX(double)>;
using Target = std::variant<std::monostate, MatX, ReferencesOfTime>;

template <class Run>
Outcome keep(SteppedWorld& sim, const std::optional<ProgressCallback>& progress, const OwnRun* guide, bool planned,
             Run call, const MovingReferences& references = {}) {
  auto own = std::make_unique<OwnRun>(OwnRun{KeptRun(), &sim.scene(), sim.options(), nb::find(sim.scene()), planned});
  KeptRun& run = own->run;
  const Progress callback = wrapped(progress);
  sim.forget_steps();
  const auto start = std::chrono::steady_clock::now();
  {
    nb::gil_scoped_release release;
    std::optional<Guide> before;
    if (guide != nullptr && Guide::pays(sim.scene().tree))
      sim.follow(&before.emplace(sim.scene().tree, arrays_of(guide->run.recording.segments),
                                 impact_times(guide->run.recording)));
    run.status = call(callback, run.recording);
    sim.follow(nullptr);
  }
  run.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  run.state = sim.state();
  run.counters = sim.counters();
  run.references = references;
  nb::object error = nb::none();
  if (UserErrors::any()) error = UserErrors::take();
  return Outcome(nb::make_tuple(nb::cast(own.release(), nb::rv_policy::take_ownership), error));
}

// Not a number from the first call on that fails, which ends the run.
MovingReferences references_of(const ReferencesOfTime& function, Eigen::Index numbers) {
  return [call = std::make_shared<nb::object>(function), numbers](double t) {
    nb::gil_scoped_acquire gil;
    const VecX none = VecX::Constant(numbers, std::numeric_limits<double>::quiet_NaN());
    if (UserErrors::any()) return none;
    try {
      const VecX found = nb::cast<VecX>((*call)(t));
      if (found.size() == numbers) return found;
    } catch (nb::python_error& error) {
      UserErrors::keep(error);
    } catch (const std::exception&) {  // something of a wrong type
    }
    return none;
  };
}

Outcome run_auto(SteppedWorld& sim, double duration, double level, const std::optional<ProgressCallback>& progress,
                 const OwnRun* coarser, double part, double sample, int after_impact, const Target& target,
                 const std::vector<double>& ends) {
  if (!(duration > 0.0) || !(level > 0.0) || !(part > 0.0)) throw Error("duration, level and part must be > 0");
  if (!(sample >= 0.0) || after_impact < 1) throw Error("sample must be >= 0, after_impact >= 1");
  if (sim.options().stages < 2) throw Error("an automatic step needs order >= 4");
  const Eigen::Index numbers = 2 * sim.scene().tree.nv;
  MatX constant;
  MovingReferences moving;
  if (const auto* row = std::get_if<MatX>(&target)) {
    if (row->rows() != 1 || row->cols() != numbers) throw Error("target has the wrong shape");
    constant = *row;
  } else if (const auto* function = std::get_if<ReferencesOfTime>(&target)) {
    moving = references_of(*function, numbers);
  }
  std::optional<StepPlan> plan;
  if (coarser != nullptr && !coarser->run.recording.adaptive_t.empty())
    plan.emplace(StepPlan{coarser->run.recording, part, coarser->planned});
  return keep(
      sim, progress, coarser, plan.has_value(),
      [&](const Progress& callback, Recording& recording) {
        return sim.run_auto(duration,
                            {level, plan ? &*plan : nullptr, sample, ends.empty() ? nullptr : &ends, after_impact,
                             constant, moving ? &moving : nullptr},
                            callback, recording);
      },
      moving);
}

Dict results(OwnRun& own) {
  KeptRun& run = own.run;
  return run_results(*own.scene, own.options, run.recording, run.state, run.counters, KeptContactSteps(), run.status,
                     run.seconds);
}

}  // namespace

const KeptRun& OwnRun::compared() const {
  if (!options.dense) throw Error("runs that are compared need the polynomials of their steps");
  if (run.recording.t.empty()) throw Error("the run has been handed over");
  return run;
}

void expose_kept_runs(nb::module_& m, nb::class_<SteppedWorld>& simulator) {
  const auto count = [](std::size_t n) { return static_cast<long>(n); };
  nb::class_<OwnRun>(m, "KeptRun", "A run with the polynomials of its steps, kept in the engine.")
      .def_prop_ro("code", [](const OwnRun& own) { return own.run.status.code; })
      .def_prop_ro(
          "time", [](const OwnRun& own) { return own.run.status.time; }, "Reached [s].")
      .def_prop_ro(
          "seconds", [](const OwnRun& own) { return own.run.seconds; }, "Wall time.")
      .def_prop_ro(
          "t", [](const OwnRun& own) { return own.run.recording.t; }, "Times of the nodes [s].")
      .def_prop_ro(
          "counts_work", [](const OwnRun& own) { return counts_work(own.run.recording); },
          "Whether it counts work or reactions, which are known at its nodes alone.")
      .def_prop_ro("nodes", [count](const OwnRun& own) { return count(own.run.recording.t.size()); })
      .def_prop_ro("segments", [count](const OwnRun& own) { return count(own.run.recording.segments.t.size()); })
      .def_prop_ro("sweeps", [](const OwnRun& own) { return own.run.counters.steps.stage_iterations; })
      .def_prop_ro(
          "contact_changes", [count](const OwnRun& own) { return count(own.run.recording.changes.size()); },
          "Begins, ends and slips of persistent contacts.")
      .def_prop_ro("dense_steps", [](const OwnRun& own) { return own.run.state.dense_steps; })
      .def_prop_ro("contact_iterations", [](const OwnRun& own) { return own.run.counters.contact.contact_iterations; })
      .def_prop_ro(
          "contact_time", [](const OwnRun& own) { return contact_time(own.run); },
          "Length of the steps with persistent contacts together [s].")
      .def_prop_ro(
          "size", [](const OwnRun& own) { return motion_size(own.scene->tree, own.compared()); },
          "Largest distance of a node from the first one [m, rad].")
      .def_prop_ro(
          "first_step_error",
          [](const OwnRun& own) { return first_step_error(*own.scene, own.options, own.compared()); },
          "Largest distance between a first step of a flight and two halves of it [m, rad].")
      .def(
          "distances",
          [](const OwnRun& found, const OwnRun& other, int times, bool over_time, bool ended) {
            if (times < 1) throw Error("times must be >= 1");
            return distances(*found.scene, other.options, other.compared(), found.compared(), times, over_time, ended);
          },
          "other"_a, "times"_a, "over_time"_a = false, "ended"_a = false,
          "Distances of another run from the nodes of this one, evenly over the nodes or the time; infinite where one"
          " ended much earlier, unless `ended`: then up to the earlier end.")
      .def(
          "error_share",
          [](const OwnRun& found, const OwnRun& companion, int power, double dt_contact) {
            return error_share(companion.compared(), found.compared(), power, dt_contact);
          },
          "companion"_a, "power"_a, "dt_contact"_a,
          "Error over what that of the companion is larger, by the lengths h of the segments and the law h^power; inf:"
          " the runs are too much alike; NaN: unknown, because contacts persist and the impacts differ.")
      .def(
          "take_segments",
          [](OwnRun& own) {
            own.compared();
            return segments(own.scene->tree, own.options.stages, own.run.recording.segments);
          },
          "Hand over the polynomials of its steps, as results() does; it cannot be compared any more.")
      .def("results", &results, "Hand over what Simulator.advance returns, without \"error\"; the run is empty then.");
  simulator.def(
      "run_auto", &run_auto, "duration"_a, "level"_a, "progress"_a = nb::none(), "coarser"_a = nb::none(),
      "part"_a = 1.0, "sample"_a = 0.0, "after_impact"_a = 1, "target"_a = nb::none(), "ends"_a = std::vector<double>(),
      "Run with a step chosen between impacts; level [m; rad] bounds what the stage polynomials leave out."
      " coarser: a run before, of whose steps these are this part. sample: multiples of it after the start [s] are"
      " nodes where steps are at most twice as long; 0: none. after_impact: steps at least from an impact to the end"
      " of its step. target: references of servos, (1, 2 nv), or a function t -> (2 nv,). ends: ascending times [s] at"
      " which steps end, too. Return (KeptRun, error of a callback or None).");
}

}  // namespace contactvi

// What the engine recorded of a run as dicts of arrays, in the numbers and coordinates of the Python API.
#include "bindings/run_results.hpp"

#include <nanobind/eigen/dense.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <optional>

#include "bindings/contact_results.hpp"
#include "model/coordinates.hpp"

namespace nb = nanobind;

namespace contactvi {

namespace {

Dict stats(const RunState& state, const EngineCounters& counters, double seconds) {
  Dict d;
  d["steps"] = state.step;
  d["stage_iterations"] = counters.steps.stage_iterations;
  d["halved"] = state.control.halved;
  d["rejected"] = state.rejected;
  d["factorizations"] = counters.steps.factorizations;
  d["guards_evaluated"] = counters.guards.evaluated;
  d["guards_skipped"] = counters.guards.skipped;
  d["distances"] = counters.guards.distances;
  d["impacts"] = state.impacts;
  d["seconds"] = seconds;
  d["saturated"] = state.actuators.saturated + state.switches.jumps;
  d["switches"] = state.switches.located;
  d["held_branches"] = state.switches.held;
  add_contact_stats(counters, state, d);
  return d;
}

// Turns momenta into public coordinates, row after row, at the configurations of q.
void make_public(const Tree& tree, const std::vector<double>& q, std::vector<double>& p) {
  if (tree.split.empty() && tree.followers.empty()) return;
  std::optional<Integrator> equations;
  if (!tree.followers.empty()) equations.emplace(tree, 1, 1e-12, 1);
  VecX qi(tree.nq), pi(tree.nv);
  for (std::size_t i = 0; i * tree.nv < p.size(); ++i) {
    Eigen::Map<VecX> row(p.data() + i * tree.nv, tree.nv);
    qi = Eigen::Map<const VecX>(q.data() + i * tree.nq, tree.nq);
    pi = row;
    if (equations) equations->complete_momentum(qi, pi);
    engine_to_public(tree, qi, pi);
    row = pi;
  }
}

}  // namespace

Dict segments(const Tree& tree, int stages, Segments& s) {
  const std::size_t n = s.t.size();
  Dict d;
  d["t"] = hand_over(std::move(s.t));
  d["h"] = hand_over(std::move(s.h));
  d["q"] = hand_over(std::move(s.q), n, tree.nq);
  d["p"] = hand_over(std::move(s.p), n, tree.nv);
  d["p1"] = hand_over(std::move(s.p1), n, tree.nv);
  d["persistent"] = hand_over(std::move(s.persistent));
  d["rates"] = hand_over(std::move(s.rates), n, static_cast<std::size_t>(tree.nv) * stages);
  return d;
}

void add_status(const Scene& s, const Status& status, nb::dict& d) {
  const PublicGuard guard = public_guard(s, status.guard);
  d["code"] = status.code;
  d["message"] = status.message;
  d["time"] = status.time;
  d["guard_kind"] = guard.kind;
  d["guard_index"] = guard.index;
  d["accumulation_time"] = status.accumulation_time;
  d["depth"] = status.depth;
}

Dict run_results(const Scene& s, const SimulatorOptions& options, Recording& recording, const RunState& state,
                 const EngineCounters& counters, KeptContactSteps kept, const Status& status, double seconds) {
  Dict d;
  const std::size_t n = recording.t.size(),
                    rows = static_cast<std::size_t>(s.tree.elements.constraint_rows) + s.tree.followers.size();
  recording.work.resize(4 * n, 0.0);  // it is empty where nothing does work
  d["work"] = hand_over(std::move(recording.work), n, 4);
  d["reactions"] = rows == 0 ? nb::object(nb::none()) : nb::cast(hand_over(std::move(recording.reactions), n, rows));
  make_public(s.tree, recording.q, recording.p);
  d["t"] = hand_over(std::move(recording.t));
  d["q"] = hand_over(std::move(recording.q), n, s.tree.nq);
  d["p"] = hand_over(std::move(recording.p), n, s.tree.nv);
  d["events"] = recording.impacts.empty() ? nb::object(nb::none()) : nb::object(impact_rows(s, recording.impacts));
  d["segments"] =
      options.dense ? nb::object(segments(s.tree, options.stages, recording.segments)) : nb::object(nb::none());
  d["adaptive_steps"] = nb::none();
  if (!recording.adaptive_t.empty()) {
    Dict steps;
    steps["t"] = hand_over(std::move(recording.adaptive_t));
    steps["dt"] = hand_over(std::move(recording.adaptive_dt));
    d["adaptive_steps"] = steps;
  }
  d["contacts"] = contact_rows(s, recording.contacts);
  d["still"] = still_contacts(recording.still);
  d["changes"] = contact_changes(s, recording.changes);
  d["phases"] = step_phases(recording);
  d["dense"] = dense_steps(s, recording);
  const bool none = kept.steps.empty() && kept.blocks.empty() && kept.dense.empty() && kept.held.empty();
  d["kept_steps"] = none ? nb::object(nb::none()) : nb::cast(std::move(kept));
  d["stats"] = stats(state, counters, seconds);
  add_status(s, status, d);
  d["forced"] = false;
  return d;
}

}  // namespace contactvi

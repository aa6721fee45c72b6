#include "run/run_state.hpp"

namespace contactvi {

void add_counts(const RunState& part, RunState& sum) {
  sum.impacts += part.impacts;
  sum.control.halved += part.control.halved;
  sum.actuators.saturated += part.actuators.saturated;
  sum.switches.located += part.switches.located;
  sum.switches.jumps += part.switches.jumps;
  sum.switches.held += part.switches.held;
  sum.contact_seconds += part.contact_seconds;
}

void sum_up(const EngineCounters& part, EngineCounters& sum) {
  sum.steps.steps += part.steps.steps;
  sum.steps.stage_iterations += part.steps.stage_iterations;
  sum.steps.factorizations += part.steps.factorizations;
  sum.guards.evaluated += part.guards.evaluated;
  sum.guards.skipped += part.guards.skipped;
  sum.guards.distances += part.guards.distances;
  sum.contact.steps += part.contact.steps;
  sum.contact.contact_iterations += part.contact.contact_iterations;
  sum.contact.problems += part.contact.problems;
  sum.contact.iterations += part.contact.iterations;
  sum.contact.fallbacks += part.contact.fallbacks;
  sum.dense.problems += part.dense.problems;
  sum.dense.sweeps += part.dense.sweeps;
  sum.dense.factorizations += part.dense.factorizations;
  sum.dense.gap_iterations += part.dense.gap_iterations;
  sum.dense.passes += part.dense.passes;
}

}  // namespace contactvi

// All that the rest of a run depends on, as values: a snapshot is a copy, and going back is an assignment.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "base/error.hpp"
#include "contact/contact_step.hpp"
#include "contact/dense_step.hpp"
#include "event/finder.hpp"
#include "impact/impact_law.hpp"
#include "record/recording.hpp"
#include "run/actuation.hpp"
#include "run/branches.hpp"
#include "run/dense_phase.hpp"
#include "run/long_steps.hpp"
#include "run/step_control.hpp"
#include "run/work_account.hpp"
#include "run/zeno_detector.hpp"

namespace contactvi {

// A point that is no contact although its gap is closed: it has separated, or it was left: it went beyond the border of
// its feature, and other points took its place.
struct SeparatedPoint {
  int guard;
  std::int64_t feature;
  bool left = false;
};

// A span in which persistent contacts are left to contact steps of order 2, for smooth steps failed to hold them.
struct ContactStepsUntil {
  double time = -1e300;  // its end,
  double span = 0.0;     // and length [s]; each that follows at once is twice as long
};

// What the event loop itself carries from step to step. The persistent contacts are in the memory of the contact step,
// which guards touch in that of the event finder.
struct RunState {
  double start_time = 0, time = 0;  // [s] of the reset, now
  long step = 0;                    // steps since the reset
  VecX q, p;                        // engine coordinates
  Status status;
  StepControl control;
  double adaptive_dt = 0;  // length of the steps of run_auto [s]
  ImpactReference reference;
  Flights flights;
  double largest_speed = 0;  // largest normal speed of a closed contact so far [m/s]
  std::vector<SeparatedPoint> separated;
  std::vector<ChangeRecord> initial_changes;  // changes of contact made by reset, which the next run records
  ActuatorState actuators;
  SwitchCounts switches;
  EnergyWatch watch;
  WorkAccount work;
  DensePhase dense;
  long impacts = 0, rejected = 0, dense_steps = 0;
  double contact_seconds = 0;
  double deepest = 0;  // the least gap of a pair that a record tells of [m]
  ContactStepsUntil contact_steps;
};

// What the parts of the engine start the next step from, besides the state of the run.
struct EngineMemory {
  Integrator::Memory integrator;
  ContactStep::Memory contact_step;
  DenseStep::Memory dense_step;
  EventFinder::Memory finder;
  Guards::Memory guards;
  bool searched_contact_step = false;  // whether the finder searched a contact step last
};

// What a joint with friction remembers.
struct JointFriction {
  bool anchored = false;  // whether it sticks
  double anchor = 0.0;    // and where
  double force = 0.0;     // mean over the last dense step [N; N m]
};

// What bodies carry from one engine to another when they meet or part: their motion, their contacts, and the history
// that decides about these. Numbers are those of the engine's scene.
struct Handover {
  VecX q, p;
  StepControl control;
  double largest_speed = 0;
  ContactStepsUntil contact_steps;
  std::vector<PersistentContact> contacts;
  std::vector<int> touching, exempt;  // guards, as the event finder knows them
  std::vector<SeparatedPoint> separated;
  std::vector<Flights::Entry> flights;
  DensePhase dense;
  DenseStep::Memory dense_step;
  std::vector<JointFriction> joint_friction;
  bool any = true;  // whether one of the lists may have entries
};

struct EngineCounters {
  StepCounters steps;
  GuardCounters guards;
  ContactStepCounters contact;
  DenseStepCounters dense;
};
// Adds what a part of the scene has counted: impacts, halved steps, what actuators and ropes did, time in contact.
void add_counts(const RunState& part, RunState& sum);
void sum_up(const EngineCounters& part, EngineCounters& sum);

struct Snapshot {
  RunState run;
  EngineMemory memory;
  EngineCounters counters;
};

}  // namespace contactvi

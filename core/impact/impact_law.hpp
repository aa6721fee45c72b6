// Impact maps: what an impact conserves besides the momentum along the surface. Each map is one file (ctec, dtec, mhc)
// that implements ImpactLaw; impact_law() (impact_maps.hpp) is the only place that tells them apart.
//
//   p+ = p- + lambda W^T, lambda >= 0;  gamma = W M^-1 p;  G_c = W M^-1 W^T;  loss = (1 - e^2) gamma-^2 / (2 G_c).
//
// CTEC's lambda is explicit. The other maps are one scalar equation in lambda (scalar_map.hpp), whose target is the
// scalar before the impact less the loss; the run keeps it in an ImpactReference. With constraints W is the row with
// the impulses of the constraints that it entails (step/projection.hpp), and the steps are those that the constraints
// act in. What moves by itself, the constraints that are prescribed motions, gives gamma a part of its own, `offset`,
// and does the work -lambda offset in the impact.
#pragma once

#include "step/stepper.hpp"

namespace contactvi {

// The numbers are those of stored events: append, never renumber.
enum class ImpactMap : int { kCtec = 0, kDtec = 1, kMhc = 2 };

// The value of the modified Hamiltonian that MHC conserves: that of the start of the step, or that of the start of the
// run less the losses of all impacts since.
enum class MhcReference : int { kStep = 0, kRun = 1 };

// Why an impulse is CTEC's instead of the map's own. The numbers are those of stored events.
enum class Fallback : int {
  kNone = 0,
  kPlastic = 1,        // gamma+ = 0: the energy equation is singular, and lambda is CTEC's
  kNoConvergence = 2,  // no root near CTEC's
  kInadmissible = 3,   // a root with lambda < 0, gamma+ <= 0 or, with e < 1, gamma+ > -gamma-
  kGrazing = 4,        // too slow for the equation to fix lambda: its root lies far from CTEC's
  kPersistent = 5,     // in persistent contact the rest of the step is not the smooth one that the scalar belongs to
  kGain = 6,           // the coefficient of restitution would make energy; it is lowered where the pair's law says so
};

struct ImpactProblem {
  Stepper& rest;        // makes the rest of the step
  const VecX& q;        // q_c, (nq,)
  const VecX& p_minus;  // (nv,)
  const VecX& W;        // gap gradient at q_c, (nv,)
  const VecX& MinvW;    // M^-1 W^T, (nv,)
  double gamma_minus;   // < 0
  double G_c;
  double offset;       // part of gamma that prescribed motions make
  double restitution;  // in [0, 1]
  double time;         // of the impact [s]
  double dt;           // full step, for the modified Hamiltonian
  double remainder;    // of the step after the impact
  const VecX& tau;     // (nv,) or empty
  double target;       // value that the map's scalar shall have after the impact; unused by CTEC

  double loss() const { return 0.5 * (1.0 - restitution * restitution) * gamma_minus * gamma_minus / G_c; }
};

struct ImpactResult {
  bool ok = false;
  double impulse = 0;  // lambda
  double jump = 0;     // of the map's own scalar, beyond the loss: what is left of its equation [J]; 0 for CTEC
                       // and for a fallback where the scalar could not be evaluated
  int iterations = 0;  // evaluations of the scalar
  Fallback fallback = Fallback::kNone;
};

// What the next impacts are to conserve, carried from impact to impact.
struct ImpactReference {
  MhcReference kind = MhcReference::kStep;
  double value = 0;  // of the map's scalar, less the losses of the impacts since it was taken [J]
  // MHC with kStep: the state and the time [s] at the start of the step, and the number of the step that `value` is of;
  // -1: of none yet.
  VecX q, p;
  double t = 0;
  long step = -1;
};

// A state (q, p) at the time t [s] without persistent contacts. After a partial step to an event, and before the step
// is told that it is taken, the stepper still holds it.
struct FreeState {
  Stepper& stepper;
  const VecX &q, &p;
  double t, dt;  // dt: full step [s]
};

class ImpactLaw {
 public:
  virtual const char* name() const = 0;
  // Whether the impulse solves an equation over the rest of the step, so that this must not be cut once it is chosen.
  virtual bool implicit() const = 0;
  // Whether contacts may stay closed: a map that has no answer for a plastic impact ends the run there.
  virtual bool allows_persistent_contact() const = 0;

  // The reference at the start of a run, at the start of a step and where free motion resumes after persistent contact.
  virtual void start_run(const FreeState& /*start*/, ImpactReference&) const {}
  virtual void start_step(const FreeState& /*start*/, ImpactReference&) const {}
  virtual void resume(const FreeState& /*now*/, ImpactReference&) const {}
  // reference.value becomes that of the map's scalar before the event at `now`, its losses not yet subtracted. What
  // damping, inputs, joint friction and prescribed motions have done since the scalar's own instant (the middle of the
  // partial step, or the node) is added, so that the impact does not give it back. partial: length of the step to the
  // event [s]; step: number of the step.
  virtual void evaluate_before(const FreeState& /*now*/, double /*partial*/, long /*step*/, ImpactReference&) const {}

  // p is p- on entry and p+ on return, shape (nv,).
  virtual ImpactResult apply(const ImpactProblem& problem, VecRef p) const = 0;
  // The map's own impulse beside `start`: CTEC's, or that of an impact with friction or several points. p_minus +
  // impulse W is what it leads to, and only its size is changed. p becomes p+.
  virtual ImpactResult correct(const ImpactProblem& problem, const ImpactResult& start, VecRef p) const = 0;

 protected:
  ~ImpactLaw() = default;
};

}  // namespace contactvi

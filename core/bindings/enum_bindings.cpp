// The enumerations that cross to Python. Where their numbers stand in the arrays of a run they are part of the file
// format too (contactvi/records/codes.py): values are appended, never renumbered.
#include <nanobind/nanobind.h>

#include "base/error.hpp"
#include "bindings/contact_results.hpp"
#include "bindings/expose.hpp"
#include "geometry/manifold.hpp"
#include "impact/impact_law.hpp"
#include "model/elements.hpp"
#include "record/recording.hpp"
#include "run/dense_phase.hpp"

namespace nb = nanobind;

namespace contactvi {

namespace {

void expose_run_enums(nb::module_& m) {
  nb::enum_<StatusCode>(m, "StatusCode", nb::is_arithmetic(), "How a run ended.")
      .value("SUCCESS", StatusCode::kSuccess)
      .value("ZENO", StatusCode::kZeno)
      .value("NEWTON_FAILED", StatusCode::kNewtonFailed)
      .value("NOT_FINITE", StatusCode::kNotFinite)
      .value("EVENT_UNRESOLVED", StatusCode::kEventUnresolved)
      .value("TOO_MANY_IMPACTS", StatusCode::kTooManyImpacts)
      .value("PENETRATION", StatusCode::kPenetration)
      .value("INTERRUPTED", StatusCode::kInterrupted)
      .value("CONSTRAINT", StatusCode::kConstraint)
      .value("TOO_MANY_STEPS", StatusCode::kTooManySteps)
      .value("IMPACT_UNSOLVED", StatusCode::kImpactUnsolved);
  nb::enum_<ImpactMap>(m, "ImpactMap", nb::is_arithmetic(), "What an impact conserves besides the momentum.")
      .value("CTEC", ImpactMap::kCtec)
      .value("DTEC", ImpactMap::kDtec)
      .value("MHC", ImpactMap::kMhc);
  nb::enum_<MhcReference>(m, "MhcReference", "Where the value that MHC conserves is taken from.")
      .value("LOCAL", MhcReference::kStep, "The start of the step.")
      .value("GLOBAL", MhcReference::kRun, "The start of the run, less the losses of all impacts since.");
  nb::enum_<ContactSteps>(m, "ContactSteps", nb::is_arithmetic(), "Which steps a run takes where bodies touch.")
      .value("AUTO", ContactSteps::kAuto)
      .value("EVENTS", ContactSteps::kEvents)
      .value("STEPS", ContactSteps::kDense);
  nb::enum_<StepKind>(m, "StepKind", nb::is_arithmetic(), "The kind of a step.")
      .value("FREE", StepKind::kFree)
      .value("PERSISTENT", StepKind::kPersistent)
      .value("DENSE", StepKind::kDense);
  nb::enum_<Fallback>(m, "Fallback", nb::is_arithmetic(), "Why the impulse of an impact is not that of its law.")
      .value("NONE", Fallback::kNone)
      .value("PLASTIC", Fallback::kPlastic)
      .value("NO_CONVERGENCE", Fallback::kNoConvergence)
      .value("INADMISSIBLE", Fallback::kInadmissible)
      .value("GRAZING", Fallback::kGrazing)
      .value("PERSISTENT", Fallback::kPersistent)
      .value("GAIN", Fallback::kGain);
}

void expose_contact_enums(nb::module_& m) {
  nb::enum_<GuardKind>(m, "GuardKind", nb::is_arithmetic(), "What a guard function watches.")
      .value("CONTACT", GuardKind::kContact, "The distance of a pair of shapes.")
      .value("LIMIT", GuardKind::kLimit, "The distance of a joint from one of its limits.");
  nb::enum_<ContactMode>(m, "ContactMode", nb::is_arithmetic(), "What a contact did in a step.")
      .value("STICK", ContactMode::kSticks)
      .value("SLIP", ContactMode::kSlips)
      .value("FRICTIONLESS", ContactMode::kFrictionless)
      .value("IMPACT", ContactMode::kImpact);
  nb::enum_<Change>(m, "ContactChange", nb::is_arithmetic(), "What became of a persistent contact.")
      .value("BEGIN", Change::kBegin)
      .value("RELEASE", Change::kRelease)
      .value("STICK", Change::kStick)
      .value("SLIP", Change::kSlip)
      .value("BOUNCING_ENDED", Change::kBouncingEnds)
      .value("INCONSISTENT", Change::kInconsistent)
      .value("OVERLAP", Change::kOverlap);
  nb::enum_<PointKind>(m, "PointKind", nb::is_arithmetic(), "The geometry that a contact point comes from.")
      .value("WITNESS", PointKind::kWitness)
      .value("VERTEX", PointKind::kVertex)
      .value("RIM", PointKind::kRim)
      .value("LIMIT", PointKind::kLimit)
      .value("EDGE", PointKind::kEdge)
      .value("END", PointKind::kEnd)
      .value("RIM_LINE", PointKind::kRimLine)
      .value("SURFACE", PointKind::kSurface)
      .value("SOLIDS", PointKind::kSolids);
}

}  // namespace

void expose_enums(nb::module_& m) {
  expose_run_enums(m);
  expose_contact_enums(m);
  nb::enum_<ConstraintKind>(m, "ConstraintKind",
                            "What a constraint holds; core/model/constraints.hpp has the residuals.")
      .value("POINT", ConstraintKind::kPoint)
      .value("DISTANCE", ConstraintKind::kDistance)
      .value("WELD", ConstraintKind::kWeld)
      .value("SCREW", ConstraintKind::kScrew)
      .value("EQUALITY", ConstraintKind::kEquality)
      .value("PRESCRIBED", ConstraintKind::kPrescribed);
}

}  // namespace contactvi

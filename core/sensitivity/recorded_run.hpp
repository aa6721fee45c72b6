// A run as its derivative needs it: the smooth pieces and the impacts between them, in the order of time. Engine
// coordinates.
#pragma once

#include <vector>

#include "base/no_derivative.hpp"
#include "contact/contact_step_record.hpp"
#include "contact/dense_step_record.hpp"
#include "contact/held_step_record.hpp"
#include "impact/impact_block_record.hpp"
#include "impact/impact_law.hpp"
#include "model/scene.hpp"

namespace contactvi {

// Where a piece ends: at a time that is given (the end of a step), a given time after its start, or at an event.
enum class PieceEnd { kTime, kLength, kEvent };

// A solved step, or the part of one up to an event.
struct Piece {
  double t, h;      // start and length [s]
  VecX q, p;        // start: (nq,), (nv,)
  MatX velocities;  // at the stages, (nv, s)
  long step;        // index of the control step that it belongs to
  PieceEnd end;
  int first_impact, impacts;                   // those at its end
  bool persistent;                             // a step with persistent contacts
  const ContactStepRecord* contact = nullptr;  // of such a step,
  const DenseStepRecord* dense = nullptr;      // or of a dense one
  const HeldStepRecord* held = nullptr;        // of a smooth step that keeps rows

  // Whether other impulses act in it than those at its end.
  bool has_rows() const { return persistent || held != nullptr; }

  bool ends_itself() const {
    return held != nullptr ? held->ending == HeldStepEnd::kRest
                           : contact != nullptr && contact->ending != ContactStepEnd::kLength;
  }
};

struct RecordedImpact {
  int guard;
  double time, restitution, friction;
  double after;  // the rest of the step [s]
  int points;
  ImpactMap map;
  Fallback fallback;
  double impulse;
  VecX q, p_minus, p_plus;
  // Where several points had it together: with the records that follow it in the block, of which the last p_plus is
  // that of all.
  const ImpactBlockRecord* block = nullptr;

  int records() const { return block == nullptr ? 1 : block->impacts; }
};

struct RecordedRun {
  double t0, dt;  // [s]
  int stages;
  double tol;  // of the stage equations
  ImpactMap map;
  MhcReference mhc_reference;
  int contact_points;
  std::vector<Piece> pieces;
  std::vector<RecordedImpact> impacts;
  MatX tau;     // (steps, nv), public coordinates, or empty
  MatX target;  // (steps, 2 nv) of the servos, or empty
  VecX q_end, p_end;
};

// Engine velocities at the stages of a step of length h [s] from the rates of its chart, both (nv, s).
MatX stage_velocities(const Tree& tree, const MatX& rates, double h);

}  // namespace contactvi

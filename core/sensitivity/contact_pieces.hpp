// The pieces of a run with persistent contacts: its columns through them, with the places at which contacts stick,
// which are part of the state there.
#pragma once

#include <memory>

#include "sensitivity/contact_step_tangent.hpp"
#include "sensitivity/dense_step_tangent.hpp"
#include "sensitivity/end_force.hpp"
#include "sensitivity/event_hit.hpp"
#include "sensitivity/held_step_tangent.hpp"
#include "sensitivity/piece_inputs.hpp"
#include "sensitivity/run_directions.hpp"

namespace contactvi {

// A dense step on the way.
struct DenseStepReport {
  double time;           // its start [s]
  double error, margin;  // DenseStepTangent
  const char* why;       // the derivative is not exact; empty: it is
};

// Throws NoDerivative for a piece with persistent contacts that has no derivative: a dense step that was not kept, or
// one beside an implicit impact map.
void check_contact_piece(const RecordedRun& run, const Piece& piece);
// Throws NoDerivative where what ends a piece, a slip or a force, does not change with time.
void check_end_rate(const Piece& piece, bool by_force, double rate);
// Whether a held step ends at the zero of a force whose time has a derivative; force takes it. Else that time counts as
// given: the forces are continuous there, so that the error is one like that of the step.
bool ends_by_force(const Piece& piece, HeldStepTangent& step, const PieceInputs& inputs, EndForce& force);
// Whether a contact step ends at a time of its own: of an impact, of a slip that comes to rest, or of a release, whose
// force it takes. Where several end at one instant the time of none may be known: at such a kink it counts as given.
bool has_own_end(const ContactStepRecord& step, const ContactStepTangent& tangent, const PieceInputs& inputs,
                 EndForce& force, Kinks& kinks);
// Throws NoDerivative for a contact that sticks without having come to stick in the run.
[[noreturn]] void refuse_sticking_start(const ContactPoint& point, double time);

class ContactPieces {
 public:
  ContactPieces(const Scene& scene, const RecordedRun& run, Kinks& kinks);

  // The start of a run along so many directions: nothing sticks.
  void start(Eigen::Index count);
  // Takes a piece with rows. Throws NoDerivative.
  void take(const Piece& piece, const PieceInputs& inputs);
  // Of the piece that was taken: the derivative of its end by its length, (nv,) each.
  void solve_length(VecRef fq, VecRef fp);
  // Of the last direction, and of the columns that were moved: the change of the scalar that DTEC conserves, in a step
  // that ends with an impact [J].
  double energy_change();
  const VecX& energies() const { return energies_; }
  // Moves the columns to its end, or, where it ends with an impact, to the time of that.
  void move(const RunDirections& directions, RunColumns& columns);
  // Of the piece that was taken, a dense step.
  DenseStepReport dense_report() const {
    return {dense_step_->t, dense_->error(), dense_->margin(), dense_->approximate()};
  }
  // After all that happens at its end: what sticks from there on, as ContactStep::commit() has it.
  void keep_anchors(const RunColumns& columns);

 private:
  struct Anchor {
    ContactPoint point;
    MatX change;  // of the place, in the frame of the plane, (3, count)
  };

  std::vector<Anchor> held_anchors(const RunColumns& columns) const;
  const Anchor* anchor_of(const ContactPoint& point) const;
  void check_rests(const std::vector<VecX>& slips, const std::vector<VecX>& sizes);
  void end(bool by_force, const RunDirections& directions, RunColumns& columns);
  void move_dense(const RunDirections& directions, RunColumns& columns);
  void move_held(const RunDirections& directions, RunColumns& columns);
  VecX friction_change(const RunDirections& directions, Eigen::Index column) const;

  const Scene* scene_;
  const RecordedRun* run_;
  ContactStepTangent tangent_;
  std::unique_ptr<DenseStepTangent> dense_;  // made for the first dense step
  std::unique_ptr<HeldStepTangent> held_;    // and for the first held one
  Kinks* kinks_;
  EndForce force_;
  bool force_ends_ = false;  // the held step that was taken
  const Piece* piece_ = nullptr;
  const ContactStepRecord* step_ = nullptr;
  const DenseStepRecord* dense_step_ = nullptr;
  const Piece* held_piece_ = nullptr;  // one of the three
  const PieceInputs* inputs_ = nullptr;
  ContactStepDirection direction_;
  std::vector<Anchor> anchors_, held_anchors_;  // now; after the held step that was taken
  MatX joint_anchors_;                          // of the joints with friction, (joints, count)
  VecX size_q_, size_p_;                        // largest changes of q and p on the way, per column
  VecX energies_;
  VecX slip_;  // change of the slip whose end ends the piece, per column [m/s]
};

}  // namespace contactvi

// The pieces of a run with persistent contacts, backward: the gradient through them, with those in the places at which
// contacts stick. The transpose of ContactPieces.
#pragma once

#include <memory>

#include "sensitivity/contact_step_adjoint.hpp"
#include "sensitivity/dense_step_adjoint.hpp"
#include "sensitivity/end_force.hpp"
#include "sensitivity/held_step_adjoint.hpp"
#include "sensitivity/piece_inputs.hpp"
#include "sensitivity/run_gradient.hpp"

namespace contactvi {

class ContactPieceAdjoint {
 public:
  ContactPieceAdjoint(const Scene& scene, const RecordedRun& run, Kinks& kinks);

  // The end of a run: nothing depends on where contacts stick.
  void start();
  // Takes a piece with rows. Throws NoDerivative.
  void take(const Piece& piece, const PieceInputs& inputs);
  // Of the piece that was taken: the derivative of its end by its length, (nv,) each.
  void solve_length(VecRef fq, VecRef fp);
  // Of the last direction: the change of the scalar that DTEC conserves, in a step that ends with an impact [J].
  double energy_change() { return adjoint_.tangent().energy_change_before(); }
  // From the gradients in the places at which contacts stick after the piece to that in its end, before all else that
  // happens there.
  void leave_anchors(VecX& lq);
  // From the gradients in the state at the end of the piece and in the time at which the next one starts to those at
  // its start. lenergy: the gradient in the scalar that DTEC conserves.
  void pass(VecX& lq, VecX& lp, double& ltime, double lenergy, RunGradient& result);
  // Throws NoDerivative unless what is left says that no contact stuck at the start of the run.
  void finish() const;

 private:
  struct Anchor {
    ContactPoint point;
    double time;  // of a piece that starts with it
    Vec3 gradient;
  };

  void add_energy(double lenergy, VecX& lq, VecX& lp, double& ltime);
  Vec3 take_anchor(const ContactPoint& point);
  void leave_held_anchors(VecX& lq);
  double pass_end(bool by_force, VecX& lq, VecX& lp, double& ltime, RunGradient& result);
  void pass_dense(VecX& lq, VecX& lp, double& ltime, RunGradient& result);
  void pass_held(VecX& lq, VecX& lp, double& ltime, RunGradient& result);
  void pass_force(double lforce, VecX& lq, VecX& lp, RunGradient& result);

  const Scene* scene_;
  const RecordedRun* run_;
  ContactStepAdjoint adjoint_;
  std::unique_ptr<DenseStepAdjoint> dense_;  // made for the first dense step
  std::unique_ptr<HeldStepAdjoint> held_;    // and for the first held one
  Kinks* kinks_;
  EndForce force_;
  bool force_ends_ = false;  // the held step that was taken
  const Piece* piece_ = nullptr;
  const ContactStepRecord* step_ = nullptr;
  const DenseStepRecord* dense_step_ = nullptr;
  const Piece* held_piece_ = nullptr;  // one of the three
  const PieceInputs* inputs_ = nullptr;
  long number_ = 0;  // of the control step
  ContactStepGradient gradient_;
  DenseStepGradient dense_gradient_;
  std::vector<Anchor> anchors_;
  MatX held_anchors_;  // gradients in the places at which contacts stick after the held step, (3, contacts)
  VecX joint_anchors_;
};

}  // namespace contactvi

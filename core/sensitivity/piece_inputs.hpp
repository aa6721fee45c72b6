// What acts in the pieces of a recorded run, and what of them has no derivative.
#pragma once

#include "sensitivity/recorded_run.hpp"
#include "step/integrator.hpp"

namespace contactvi {

class PieceInputs {
 public:
  PieceInputs(const Tree& tree, const RecordedRun& run);
  // Sets the inputs of the control step that a piece belongs to.
  void set(const Piece& piece);
  const VecX& tau() const { return tau_; }  // public coordinates, (nv,) or empty
  // Takes from a change of the inputs, or from a gradient in them, what limits of actuators keep from acting in the
  // piece: (nv,) or empty.
  void mask(VecX& tau) const {
    for (const int d : held_)
      if (tau.size() > 0) tau[d] = 0.0;
  }
  bool any_held() const { return !held_.empty(); }
  const Servo* servo() const { return servo_.any ? &servo_ : nullptr; }

 private:
  void limit(const Piece& piece);

  const Tree* tree_;
  const RecordedRun* run_;
  Servo servo_;
  VecX tau_;
  std::vector<int> limited_, held_;  // dofs: with a limit of effort; at it in the piece
};

// How far a closing speed is from zero, relative to the size of its terms. Throws NoDerivative where it is too small
// for the time of the impact to have a derivative.
double check_closing(const RecordedImpact& impact, double speed, double size);
// Throws NoDerivative for an impact of an implicit map that did not act, or whose energy the motion does not conserve.
void check_map(const Tree& tree, const RecordedRun& run, const RecordedImpact& impact);
// Whether a time is the end of a step.
bool is_node(const RecordedRun& run, double time);
// Whether a piece starts where an implicit map takes its reference anew: it does not follow an event of its step.
bool starts_anew(const RecordedRun& run, std::size_t piece);

constexpr double kSameTime = 1e-9;  // of the step: times that differ by less are one

}  // namespace contactvi

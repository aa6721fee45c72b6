// The impulse at the end of a step where contacts slide, which leaves the rows no velocity.
//
// Along rows with gradients W and tangents T of sliding contacts, at the momentum p: impulses lambda along
// F = W - mu T d, column by column of the sliding contacts' normals, with W^T M^-1 (p + F lambda) + rate = 0, and
// directions d of the slips T^T M^-1 (p + F lambda) + drift there, across which the slip is zero: Newton's method.
#pragma once

#include "step/phase_rows.hpp"
#include "step/row_system.hpp"
#include "step/step_equations.hpp"

namespace contactvi {

class SlipProjection {
 public:
  // lambda (m,) and angles (slides,), of d from the first tangents: start values, and the solution. The rows of the
  // slides' normals follow `first` others; coefficients (slides,): of their friction. A slip that has turned back, too
  // far to tell its direction, keeps that of `before`. Adds F lambda to p, and sets v = M^-1 p and the slips (slides,).
  // The node of `equations` must be placed. False: it was not found.
  bool apply(StepEquations& equations, const MatX& W, const MatX& T, const VecX& rate, const VecX& drift,
             const std::vector<PhaseRows::Slide>& slides, int first, const VecCRef& coefficients, const VecCRef& before,
             VecRef p, VecX& v, VecRef lambda, VecRef angles, VecRef slips);
  // How the velocity v of the last projection that succeeded changes with the momentum p before it: dv, (nv, columns),
  // to the first order of changes of p, which X holds and M^-1 is to be multiplied with. The node must be placed again.
  void respond(StepEquations& equations, MatX& X) const;
  // Of what friction answers to a turn of its direction, as a slip: where the slip is as far beyond its end the
  // direction is no longer found from it. At all of it the equation is singular.
  static constexpr double kTurned = 0.5;
  static constexpr double kFarTurn = 0.5;  // [rad] by which an iteration changes a direction at most

 private:
  RowSystem system_;
  // Of the last projection, by impulses and angles: the derivatives of v, and the gradients of what is to be zero.
  MatX moved_, conditions_;
};

}  // namespace contactvi

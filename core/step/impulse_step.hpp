// A midpoint step whose start momentum is found while the step is solved, as the impulses of persistent contacts are
// (contact/contact_step.hpp): their solution alternates with the iterations on the velocity made here.
//
// One iteration is v += D^-1 (p - p(v)), D the symmetric part of the step's Newton matrix.
#pragma once

#include "step/step_equations.hpp"

namespace contactvi {

class ImpulseStep final : public StepEquations {
 public:
  explicit ImpulseStep(const Tree& tree) : StepEquations(tree, 1) {}

  // The step of length h from q0, with the velocity v to start from.
  void begin(const VecCRef& q0, double h, const VecX& tau, const VecCRef& v);
  // One iteration with the start momentum p; factor: with D made anew; first: of this step. Returns the largest
  // |change| of v, NaN if something is not finite.
  double iterate(const VecCRef& p, bool factor, bool first);
  // The start momentum that finish() takes.
  void set_start_momentum(const VecCRef& p) { p0_ = p; }
  // X <- D^-1 X, after an iteration that made D.
  void solve_step_matrix(Eigen::Ref<MatX> X);
  // The velocity of the stage, and a change of it.
  void stage_velocity(VecRef v) const;
  void add_velocity(const VecCRef& dv);
};

}  // namespace contactvi

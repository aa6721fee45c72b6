// The states of a kept run between its nodes, found as closely as the nodes are.
#pragma once

#include "run/kept_run.hpp"

namespace contactvi {

class StatesBetween {
 public:
  // options: of the run. The run stays the caller's.
  StatesBetween(const Scene& scene, const SimulatorOptions& options, const KeptRun& run);
  StatesBetween(const StatesBetween&) = delete;
  StatesBetween& operator=(const StatesBetween&) = delete;

  SegmentPaths& paths() { return paths_; }
  Integrator& integrator() { return integrator_; }
  // Whether steps are known whole only, by their polynomials: the branches of actuators in them are not kept.
  bool has_branches() const { return has_branches_; }
  bool has_servos() const { return servo_.any; }
  // Advances a state by h, in the fewest powers of two of parts that are solved, led by the run. begin: of the state
  // [s]; the references of servos are those of the step that starts at `step` [s].
  bool advance(double step, double begin, double h, VecX& q, VecX& p);
  // By a step from the start of the segment; where contacts persist, and where the step is not solved, from the
  // polynomial. False: the mass matrix is not positive definite.
  bool configuration(double time, VecX& q) { return find(time, q) != Found::kNothing; }
  // As this, with the momentum; from the polynomial where that leaves out no more than the tolerance of the steps, too.
  bool state(double time, VecX& q, VecX& p);

 private:
  enum class Found { kNothing, kMomentum, kVelocity };
  Found find(double time, VecX& q);

  SegmentPaths paths_;
  Guide guide_;
  Integrator integrator_;
  Servo servo_;
  bool has_branches_;
  double tol_;
  VecX p_;  // the momentum or the velocity that was found last
  VecX unused_;
};

}  // namespace contactvi

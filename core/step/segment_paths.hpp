// The motion of a finished run at any time, from its segments.
#pragma once

#include "step/integrator.hpp"
#include "step/segment_arrays.hpp"

namespace contactvi {

class SegmentPaths {
 public:
  SegmentPaths(const Tree& tree, int stages, const SegmentArrays& segments);

  Eigen::Index count() const { return segments_.count; }
  double start(Eigen::Index i) const { return segments_.t[i]; }
  double length(Eigen::Index i) const { return segments_.h[i]; }
  bool persistent(Eigen::Index i) const { return segments_.persistent[i] != 0.0; }
  Eigen::Map<const VecX> q(Eigen::Index i) const { return {segments_.q + i * q1_.size(), q1_.size()}; }
  Eigen::Map<const VecX> p(Eigen::Index i) const { return {segments_.p + i * v0_.size(), v0_.size()}; }
  // The last segment that starts at or before this time [s]; the first one for earlier times.
  Eigen::Index at(double time) const;
  // The polynomial of a segment, raised by the velocities at its ends; valid until the next call. Null: the mass
  // matrix is not positive definite.
  const StepPath* path(Eigen::Index segment, StepEquations& equations);
  // The state at a time [s] by a step from the start of its segment to there, which is as accurate as a node where it
  // is solved to tol; from the polynomial where that leaves out no more than tol, where contacts persist, at a node,
  // and where the step is not solved.
  bool state(double time, double tol, Integrator& integrator, VecRef q, VecRef v);
  // As this, with the momentum instead of the velocity.
  bool momentum(double time, double tol, Integrator& integrator, VecRef q, VecRef p);
  // The state as by state(), always from the polynomial.
  bool state(double time, StepEquations& equations, VecRef q, VecRef v);
  // Of its segment that lies before a time [s]: the part that a step to there makes. 0 at a node, where it makes none.
  double step_to(double time) const;

 private:
  double fraction(double time, Eigen::Index segment) const;
  void set(Eigen::Index segment);
  void find_left_out();
  bool is_enough(double time, double tol);
  // The step to a time [s], whose end is in q and p; false where there is none: then the polynomial gives the state.
  bool make_step(double time, double tol, Integrator& integrator, VecRef q, VecRef p);
  void read(double time, VecRef q, VecRef v) const;

  const Tree* tree_;
  SegmentArrays segments_;
  int stages_;
  StepPath path_;
  Eigen::Index set_ = -1;  // segment of path_
  double left_out_ = 0.0;  // of the rates by path_, relative
  VecX q1_, p1_, v0_, v1_;
};

}  // namespace contactvi

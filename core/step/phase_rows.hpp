// Rows that a step keeps besides the constraints of the scene, as long as a phase of persistent contact lasts: closed
// gaps, material points that stick to each other, surfaces that roll on each other.
//
// Each row has an impulse at every node of a step, which acts along its gradient. Beside its normal row a sliding
// contact has no rows but two tangents: its friction is mu times its normal impulse, against its slip. Joints with
// friction have a row where they stick, and else a constant force.
#pragma once

#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

class PhaseRows {
 public:
  // A sliding contact: the row of its gap, and its coefficient of friction as the step begins.
  struct Slide {
    int normal;
    double mu;
  };

  virtual ~PhaseRows() = default;
  virtual int count() const = 0;
  // Whether a row is one of velocities, W.v = 0, which has no displacement that it is the rate of.
  virtual bool by_rate(int row) const = 0;
  virtual const std::vector<Slide>& slides() const = 0;
  // Whether the coefficient of a slide depends on its speed, and whether that of some slide does on its normal force.
  virtual bool friction_varies(int slide) const = 0;
  virtual bool friction_by_forces() const = 0;
  // A slide with its speed [m/s], its normal force [N] and the time [s]; its coefficient is set by set_friction, which
  // tells whether some has changed by more than rounding.
  struct SlideState {
    int slide;
    double speed, normal, time;
    double* mu;
  };
  virtual bool set_friction(const std::vector<SlideState>& slides) const = 0;
  // Whether any contact adheres.
  virtual bool any_adheres() const = 0;
  // What is set at a configuration of the step: displacements phi (count,), gradients W (nv, count), tangents
  // T (nv, 2 per slide); and the velocities that surfaces have of themselves, where some move along themselves, beside
  // W^T v (count,) and T^T v (2 per slide,).
  struct Placed {
    VecRef phi;
    Eigen::Ref<MatX> W, T;
    VecRef rate, drift;
    VecRef pull;  // adhesion along the gradients, of what adheres [N], (count,)
  };
  // At the time t [s]. Tangents turn with their surfaces from place 0 on, the start of the step, which comes first.
  virtual void place(int place, const VecCRef& q, double t, Placed at) = 0;
  // Constant forces of the step (nv,), those of joints that slide against their friction; null: none.
  virtual const VecX* load() const = 0;
  // Direction of the slip at the start, as an angle from the first tangent [rad]; slip: its components there, of a
  // motion of this speed.
  virtual double start_angle(int slide, const Eigen::Vector2d& slip, double speed) const = 0;
};

}  // namespace contactvi

// A frame that the user moves in the world. It is the signal of a weld whose body a is the world: the frame of a is
// then this one.
#pragma once

#include <functional>

#include "model/elements.hpp"

namespace contactvi {

// Pose, and velocity of the origin and angular velocity, world frame.
struct FrameMotion {
  Vec3 p_W;
  Mat3 R_W;
  Vec3 v_W, omega_W;
};

struct MovingFrame {
  std::function<FrameMotion(double)> at;  // of the time [s]

  // As a signal it has no number of its own.
  std::array<double, 3> operator()(double) const { return {0.0, 0.0, 0.0}; }
};

// The moving frame of a weld; null where both of its frames are fixed to bodies.
inline const MovingFrame* moving_frame(const Constraint& c) {
  return c.kind == ConstraintKind::kWeld ? c.signal.target<MovingFrame>() : nullptr;
}

}  // namespace contactvi

// How constraints phi(q, t) = 0 change with the configuration and the time: the second derivatives of phi. Engine
// coordinates.
#pragma once

#include "model/body_twists.hpp"
#include "model/constraints.hpp"

namespace contactvi {

class ConstraintTangent {
 public:
  explicit ConstraintTangent(const Tree& tree);

  // Takes all constraints of the tree at q and the time t [s].
  void take(const VecCRef& q, double t);
  int rows() const { return static_cast<int>(phi_.size()); }
  // Residuals, their gradients W as columns (nv, rows), and their rates at fixed q.
  const VecX& residuals() const { return phi_; }
  const MatX& gradients() const { return W_; }
  const VecX& rates() const { return rate_; }
  const VecX& accelerations() const { return acceleration_; }  // the rates of these
  // The derivative of the gradients by the time, (nv, rows): prescribed poses have one.
  const MatX& gradient_rates() const { return W_rate_; }
  // The derivative of the gradients along dq, shape (nv,), and dt [s], as columns of dW, (nv, rows).
  void change(const VecCRef& dq, double dt, Eigen::Ref<MatX> dW);
  // That of the rates.
  VecX rate_change(const VecCRef& dq, double dt) const { return W_rate_.transpose() * dq + dt * acceleration_; }
  // That of the speeds W^T v + d phi/dt by the time, at a fixed configuration.
  VecX speed_rate(const VecCRef& v) const { return W_rate_.transpose() * v + acceleration_; }
  // The same along the motion with a constant v.
  VecX turning(const VecCRef& v);

 private:
  struct Frame {  // of a constraint with a moving frame
    FrameMotion at;
    Vec3 a_W, alpha_W;
  };
  void take_frame(const Constraint& c, double t, Frame& frame);

  const Tree* tree_;
  BodyTwists twists_;
  VecX q_, phi_, rate_, acceleration_;
  MatX W_, W_rate_, turned_;
  std::vector<Frame> frames_;  // per constraint
  bool any_frame_ = false;
};

}  // namespace contactvi

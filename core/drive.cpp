// Simulator: what pushes in a control step, and the account of what it and the rest has done.
#include <algorithm>
#include <cmath>

#include "simulator.hpp"

namespace contactvi {

namespace {

double bound(const VecX& limits, int dof) { return limits.size() > 0 ? limits[dof] : INFINITY; }

}  // namespace

// Row k of target, if there are any, are the references from now on. Where an actuator is at its limit at the start of
// the step its torque is constant over the step.
void Simulator::set_drive(const VecX& tau, const MatX& target, long k) {
  const Tree& tree = scene_->tree;
  const Elements& e = tree.elements;
  const bool servo = e.servo_kp.size() > 0, limited = e.effort.size() > 0 || e.speed.size() > 0;
  force_ = tau;
  if (!servo && !limited) return;
  if (limited && force_.size() == 0) force_.setZero(tree.nv);
  if (servo) {
    if (servo_.q_ref.size() == 0) {
      servo_.q_ref.setZero(tree.nv);
      servo_.v_ref.setZero(tree.nv);
    }
    if (target.rows() > 0) {
      servo_.q_ref = target.row(k).head(tree.nv).transpose();
      servo_.v_ref = target.row(k).tail(tree.nv).transpose();
    }
    servo_.any = true;
    servo_.kp = e.servo_kp;
    servo_.kd = e.servo_kd;
    servo_.feed.setZero(tree.nv);
  }
  integrator_.node_velocity(q_, p_, v_);
  for (const Joint& joint : tree.joints) {
    const int d = joint.iv;
    if (joint.nv != 1) continue;
    const bool driven = servo && (servo_.kp[d] != 0.0 || servo_.kd[d] != 0.0);
    double follow = 0.0;
    if (driven) {
      follow = servo_.kd[d] * (servo_.v_ref[d] - v_[d]);
      if (servo_.kp[d] != 0.0) follow += servo_.kp[d] * (servo_.q_ref[d] - q_[joint.iq]);
    }
    const double own = force_.size() > 0 ? force_[d] : 0.0, wanted = own + follow;
    const double most = std::min(bound(e.effort, d), driven ? bound(e.servo_effort, d) : INFINITY);
    double given = std::clamp(wanted, -most, most);
    if (std::abs(v_[d]) >= bound(e.speed, d) && given * v_[d] > 0.0) given = 0.0;
    if (given == wanted) continue;
    ++saturated_;
    if (driven) {
      servo_.kp[d] = servo_.kd[d] = 0.0;
      servo_.feed[d] = given - own;
    } else {
      force_[d] = given;
    }
  }
  integrator_.set_servo(servo ? &servo_ : nullptr);
  held_.set_servo(servo ? &servo_ : nullptr);
}

void Simulator::count_held_work() {
  work_.input += held_.input_work();
  work_.damping += held_.damping_loss();
  work_.dry += held_.dry_loss();
  work_.drive += held_.drive_work();
  if (held_.constrained()) reactions_ += held_.constraint_impulses();
}

// What the constraints did in the impacts since the last call.
void Simulator::count_impacts() {
  if (!held_.constrained()) return;
  reactions_ += sequence_.constraint_impulses;
  work_.drive += sequence_.drive_work;
  sequence_.constraint_impulses.setZero();
  sequence_.drive_work = 0.0;
}

// A function of the user has failed: nothing that follows can be trusted.
bool Simulator::user_failed(double time) {
  if (!*scene_->tree.elements.failed) return false;
  end(StatusCode::kNotFinite, time, "a function of the user failed");
  return true;
}

}  // namespace contactvi

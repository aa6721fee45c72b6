// Simulator: what pushes in a control step, and the account of what it and the rest has done.
#include <algorithm>
#include <cmath>

#include "run/simulator.hpp"

namespace contactvi {

namespace {

constexpr double kOverEffort = 1e-9;

double bound(const VecX& limits, int dof) { return limits.size() > 0 ? limits[dof] : INFINITY; }

}  // namespace

// Row k of target, if there are any, are the references from now on.
void Simulator::set_actuation(const VecX& tau, const MatX& target, long k) {
  const Tree& tree = scene_->tree;
  tau_ = tau;
  if (tree.elements.servo_kp.size() > 0) {
    if (servo_.q_ref.size() == 0) {
      servo_.q_ref.setZero(tree.nv);
      servo_.v_ref.setZero(tree.nv);
    }
    if (target.rows() > 0) {
      servo_.q_ref = target.row(k).head(tree.nv).transpose();
      servo_.v_ref = target.row(k).tail(tree.nv).transpose();
    }
  }
  limit_actuation();
}

// What pushes from here on. Where an actuator is at its limit its torque is constant until the next part of the step.
void Simulator::limit_actuation() {
  const Tree& tree = scene_->tree;
  const Elements& e = tree.elements;
  const bool servo = e.servo_kp.size() > 0, limited = e.effort.size() > 0 || e.speed.size() > 0;
  force_ = tau_;
  if (!servo && !limited) return;
  if (limited && force_.size() == 0) force_.setZero(tree.nv);
  if (servo) {
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
      if (servo_.kp[d] != 0.0) follow += servo_.kp[d] * joint_error(joint, q_, servo_.q_ref[d]);
    }
    const double own = force_.size() > 0 ? force_[d] : 0.0, wanted = own + follow, most = most_effort(d);
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
  apply_servo();
}

double Simulator::most_effort(int d) const {
  const Elements& e = scene_->tree.elements;
  const bool driven = e.servo_kp.size() > 0 && (e.servo_kp[d] != 0.0 || e.servo_kd[d] != 0.0);
  return std::min(bound(e.effort, d), driven ? bound(e.servo_effort, d) : INFINITY);
}

void Simulator::apply_servo() {
  const Servo* servo = scene_->tree.elements.servo_kp.size() > 0 ? &servo_ : nullptr;
  integrator_.set_servo(servo);
  contact_step_.set_servo(servo);
}

// Whether a servo was beyond its effort in the step just solved: it is at its limit then, and the step is to be solved
// again.
bool Simulator::exceeds_effort(const Integrator& integrator) {
  if (!servo_.any) return false;
  bool exceeds = false;
  for (const Joint& joint : scene_->tree.joints) {
    const int d = joint.iv;
    if (joint.nv != 1 || (servo_.kp[d] == 0.0 && servo_.kd[d] == 0.0)) continue;
    const double most = most_effort(d);
    if (!std::isfinite(most)) continue;
    const double own = force_.size() > 0 ? force_[d] : 0.0;
    double largest = 0.0;
    for (int i = 0; i < integrator.stages(); ++i) {
      const double torque = own + integrator.servo_torque(d, i);
      if (std::abs(torque) > std::abs(largest)) largest = torque;
    }
    if (!(std::abs(largest) > most * (1.0 + kOverEffort))) continue;
    servo_.kp[d] = servo_.kd[d] = 0.0;
    servo_.feed[d] = std::copysign(most, largest) - own;
    ++saturated_;
    exceeds = true;
  }
  if (exceeds) apply_servo();
  return exceeds;
}

void Simulator::count_contact_work() {
  work_.input += contact_step_.input_work();
  work_.damping += contact_step_.damping_loss();
  work_.joint_friction += contact_step_.joint_friction_loss();
  work_.drive += contact_step_.driven_work();
  if (contact_step_.constrained()) reactions_ += contact_step_.constraint_impulses();
}

// The impacts at one instant, with what the constraints do in them. False: they do not end.
bool Simulator::run_impacts(const Instant& now, Recording& recording) {
  const bool ended = sequence_.run(now, plastic_, reference_, p_, recording);
  impacts_ += sequence_.impacts();
  if (!contact_step_.constrained()) return ended;
  reactions_ += sequence_.constraint_impulses();
  work_.drive += sequence_.driven_work();
  return ended;
}

// A function of the user has failed: nothing that follows can be trusted.
bool Simulator::user_failed(double time) {
  if (!*scene_->tree.elements.failed) return false;
  end(StatusCode::kNotFinite, time, "a function of the user failed");
  return true;
}

}  // namespace contactvi

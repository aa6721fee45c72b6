// Simulator: the actuation of a control step (inputs and servos within their limits), and the work account.
#include <algorithm>
#include <cmath>

#include "run/simulator.hpp"

namespace contactvi {

namespace {

constexpr double kOverEffort = 1e-9;

double bound(const VecX& limits, int dof) { return limits.size() > 0 ? limits[dof] : INFINITY; }

}  // namespace

// Sets the input and, if target has rows, the references of the servos (its row k) for the next control step.
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

// Applies the limits of the actuators at the present state. Where an actuator is at its limit, its torque is constant
// until the next part of the step.
void Simulator::limit_actuation() {
  const Tree& tree = scene_->tree;
  const Elements& e = tree.elements;
  const bool servo = e.servo_kp.size() > 0, limited = e.effort.size() > 0 || e.speed.size() > 0;
  limited_tau_ = tau_;
  if (!servo && !limited) return;
  if (limited && limited_tau_.size() == 0) limited_tau_.setZero(tree.nv);
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
    const double own = limited_tau_.size() > 0 ? limited_tau_[d] : 0.0, wanted = own + follow, most = effort_limit(d);
    double given = std::clamp(wanted, -most, most);
    if (std::abs(v_[d]) >= bound(e.speed, d) && given * v_[d] > 0.0) given = 0.0;
    if (given == wanted) continue;
    ++saturated_;
    if (driven) {
      servo_.kp[d] = servo_.kd[d] = 0.0;
      servo_.feed[d] = given - own;
    } else {
      limited_tau_[d] = given;
    }
  }
  apply_servo();
}

double Simulator::effort_limit(int d) const {
  const Elements& e = scene_->tree.elements;
  const bool driven = e.servo_kp.size() > 0 && (e.servo_kp[d] != 0.0 || e.servo_kd[d] != 0.0);
  return std::min(bound(e.effort, d), driven ? bound(e.servo_effort, d) : INFINITY);
}

void Simulator::apply_servo() {
  const Servo* servo = scene_->tree.elements.servo_kp.size() > 0 ? &servo_ : nullptr;
  integrator_.set_servo(servo);
  contact_step_.set_servo(servo);
  dense_step_.set_servo(servo);
}

// Sets servos that were beyond their effort limit in the step just solved to that limit. True if there were any: the
// step is to be solved again.
bool Simulator::saturate_servos(const StepEquations& step) {
  if (!servo_.any) return false;
  bool exceeds = false;
  for (const Joint& joint : scene_->tree.joints) {
    const int d = joint.iv;
    if (joint.nv != 1 || (servo_.kp[d] == 0.0 && servo_.kd[d] == 0.0)) continue;
    const double most = effort_limit(d);
    if (!std::isfinite(most)) continue;
    const double own = limited_tau_.size() > 0 ? limited_tau_[d] : 0.0;
    double largest = 0.0;
    for (int i = 0; i < step.stages(); ++i) {
      const double torque = own + step.servo_torque(d, i);
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

void Simulator::add_contact_work() {
  work_.input += contact_step_.input_work();
  work_.damping += contact_step_.damping_loss();
  work_.joint_friction += contact_step_.joint_friction_loss();
  work_.driven += contact_step_.driven_work();
  if (contact_step_.constrained()) reactions_ += contact_step_.constraint_impulses();
}

// Runs the impacts at one instant and adds the reactions and the work of constraints in them. False: they do not end.
bool Simulator::run_impacts(const Instant& now, Recording& recording) {
  const bool ended = sequence_.run(now, plastic_, reference_, p_, recording);
  impacts_ += sequence_.impacts();
  if (!contact_step_.constrained()) return ended;
  reactions_ += sequence_.constraint_impulses();
  work_.driven += sequence_.driven_work();
  return ended;
}

// True if a function of the user has failed: the run ends, for no step after that can be trusted.
bool Simulator::user_function_failed(double time) {
  if (!scene_->tree.elements.user_failed()) return false;
  end(StatusCode::kNotFinite, time, "a function of the user failed");
  return true;
}

}  // namespace contactvi

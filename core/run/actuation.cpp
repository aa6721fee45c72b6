#include "run/actuation.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {

constexpr double kOverEffort = 1e-9;

double bound(const VecX& limits, int dof) { return limits.size() > 0 ? limits[dof] : INFINITY; }

}  // namespace

Actuation::Actuation(const Tree& tree, ActuatorState& state, Integrator& free, ContactStep& contact, DenseStep& dense)
    : tree_(&tree),
      state_(&state),
      free_(&free),
      contact_(&contact),
      dense_(&dense),
      v_(tree.nv),
      drive_(static_cast<std::size_t>(tree.nv), Drive::kAsked) {
  for (const Joint& joint : tree.joints)
    if (joint.nv == 1 && (std::isfinite(effort_limit(joint.iv)) || std::isfinite(speed_limit(joint.iv))))
      limited_dofs_.push_back(joint.iv);
}

Actuation::Shared::Shared(const Tree& tree, NodeCompany& with)
    : company(&with), model(tree), lanes(&with.node_lanes_of(model)), node(tree, model, 1) {}

void Actuation::join(NodeCompany& company) {
  const Elements& e = tree_->elements;
  if (e.servo_kp.size() + e.effort.size() + e.speed.size() > 0) shared_ = std::make_unique<Shared>(*tree_, company);
}

// v_ at a state.
void Actuation::find_velocity(const VecX& q, const VecX& p) {
  if (const VecX* known = contact_->accepted_velocity(q, p)) {
    v_ = *known;
    return;
  }
  if (shared_) {
    put_node(q, p, shared_->node);
    if (shared_->company->solve_masses(shared_->node, *shared_->lanes)) {
      get_velocity(shared_->node, p, v_);
      return;
    }
  }
  free_->node_velocity(q, p, v_);
}

void Actuation::start() {
  state_->saturated = 0;
  state_->servo.any = false;
  follow(nullptr);
  free_->set_servo(&state_->servo);
  contact_->set_servo(&state_->servo);
  dense_->set_servo(&state_->servo);
}

void Actuation::set(double t, const VecX& tau, const MatX& target, long k, const VecX& q, const VecX& p) {
  const Tree& tree = *tree_;
  Servo& servo = state_->servo;
  if (tau.size() > 0 || state_->given.size() > 0) state_->given = tau;
  if (tree.elements.servo_kp.size() > 0) {
    if (servo.q_ref.size() == 0) {
      servo.q_ref.setZero(tree.nv);
      servo.v_ref.setZero(tree.nv);
    }
    if (target.rows() > 0) {
      servo.q_ref = target.row(k).head(tree.nv).transpose();
      servo.v_ref = target.row(k).tail(tree.nv).transpose();
    }
  }
  limit(t, q, p);
}

void Actuation::limit(double t, const VecX& q, const VecX& p) {
  const Tree& tree = *tree_;
  VecX& limited = state_->limited;
  Servo& servo = state_->servo;
  const Elements& e = tree.elements;
  const bool has_servos = e.servo_kp.size() > 0, has_limits = e.effort.size() > 0 || e.speed.size() > 0;
  if (limited.size() > 0 || state_->given.size() > 0) limited = state_->given;
  if (!has_servos && !has_limits) return;
  if (has_limits && limited.size() == 0) limited.setZero(tree.nv);
  if (has_servos) {
    servo.any = true;
    servo.kp = e.servo_kp;
    servo.kd = e.servo_kd;
    servo.feed.setZero(tree.nv);
    if (servo.moving != nullptr) servo.refer(t);
  }
  find_velocity(q, p);
  for (const int d : limited_dofs_) {
    const double wanted = asked(d, q, t, q, v_).effort, most = effort_limit(d);
    const double given = std::clamp(wanted, -most, most);
    Drive drive = given == wanted ? Drive::kAsked : given > 0.0 ? Drive::kHigh : Drive::kLow;
    if (std::abs(v_[d]) >= speed_limit(d) && given * v_[d] > 0.0) drive = Drive::kCut;
    set_drive(d, drive);
  }
  apply_servo();
}

void Actuation::set_drive(int d, Drive drive) {
  drive_[static_cast<std::size_t>(d)] = drive;
  Servo& servo = state_->servo;
  const double most = effort_limit(d), own = this->own(d);
  const double given = drive == Drive::kHigh ? most : drive == Drive::kLow ? -most : 0.0;
  const bool asked = drive == Drive::kAsked;
  if (is_driven(d)) {
    const Elements& e = tree_->elements;
    servo.kp[d] = asked ? e.servo_kp[d] : 0.0;
    servo.kd[d] = asked ? e.servo_kd[d] : 0.0;
    servo.feed[d] = asked ? 0.0 : given - own;
  } else if (state_->limited.size() > 0) {
    state_->limited[d] = asked ? own : given;
  }
}

bool Actuation::is_any(Drive drive) const { return std::find(drive_.begin(), drive_.end(), drive) != drive_.end(); }

bool Actuation::is_any_limited() const {
  const Servo& servo = state_->servo;
  return std::any_of(limited_dofs_.begin(), limited_dofs_.end(), [&](int d) {
    return drive(d) != Drive::kAsked || (is_driven(d) && servo.kp[d] == 0.0 && servo.kd[d] == 0.0);
  });
}

void Actuation::enter(int d, Drive drive) {
  set_drive(d, drive);
  apply_servo();
}

bool Actuation::is_driven(int d) const {
  const Elements& e = tree_->elements;
  return e.servo_kp.size() > 0 && (e.servo_kp[d] != 0.0 || e.servo_kd[d] != 0.0);
}

// The input as it was given.
double Actuation::own(int d) const { return state_->given.size() > 0 ? state_->given[d] : 0.0; }

// Of a continuous joint the error is the one at the start of the part and the turn since then, also beyond half a
// revolution.
Actuation::Asked Actuation::asked(int d, const VecX& q0, double t, const VecX& q, const VecX& v) {
  const double own = this->own(d);
  Asked found{own, std::abs(own)};
  if (!is_driven(d)) return found;
  const Elements& e = tree_->elements;
  const Servo& servo = state_->servo;
  double q_ref = servo.q_ref[d], v_ref = servo.v_ref[d];
  if (servo.moving != nullptr) {
    if (t != references_time_ || references_.size() == 0) references_ = (*servo.moving)(t);
    references_time_ = t;
    q_ref = references_[d];
    v_ref = references_[tree_->nv + d];
  }
  double damper = e.servo_kd[d] * (v_ref - v[d]);
  found.size += std::abs(damper);
  if (e.servo_kp[d] != 0.0) {
    const Joint& joint = tree_->joints[static_cast<std::size_t>(tree_->dof_joint[d])];
    double error = joint_error(joint, q, q_ref);
    if (joint.type == JointType::kContinuous) {
      const double start = joint_error(joint, q0, servo.q_ref[d]) + (q_ref - servo.q_ref[d]);
      error = start + std::remainder(error - start, kTwoPi);
    }
    const double spring = e.servo_kp[d] * error;
    damper += spring;
    found.size += std::abs(spring);
  }
  found.effort += damper;
  return found;
}

double Actuation::effort_limit(int d) const {
  const Elements& e = tree_->elements;
  return std::min(bound(e.effort, d), is_driven(d) ? bound(e.servo_effort, d) : INFINITY);
}

double Actuation::speed_limit(int d) const { return bound(tree_->elements.speed, d); }

void Actuation::apply_servo() {
  const Servo* servo = tree_->elements.servo_kp.size() > 0 ? &state_->servo : nullptr;
  free_->set_servo(servo);
  contact_->set_servo(servo);
  dense_->set_servo(servo);
}

bool Actuation::saturate_servos(const StepEquations& step) {
  Servo& servo = state_->servo;
  const VecX& limited = state_->limited;
  if (!servo.any) return false;
  bool exceeds = false;
  for (const Joint& joint : tree_->joints) {
    const int d = joint.iv;
    if (joint.nv != 1 || (servo.kp[d] == 0.0 && servo.kd[d] == 0.0)) continue;
    const double most = effort_limit(d);
    if (!std::isfinite(most)) continue;
    const double own = limited.size() > 0 ? limited[d] : 0.0;
    double largest = 0.0;
    for (int i = 0; i < step.stages(); ++i) {
      const double torque = own + step.servo_torque(d, i);
      if (std::abs(torque) > std::abs(largest)) largest = torque;
    }
    if (!(std::abs(largest) > most * (1.0 + kOverEffort))) continue;
    servo.kp[d] = servo.kd[d] = 0.0;
    servo.feed[d] = std::copysign(most, largest) - own;
    exceeds = true;
  }
  if (exceeds) apply_servo();
  return exceeds;
}

}  // namespace contactvi

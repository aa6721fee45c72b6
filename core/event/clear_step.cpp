#include "event/clear_step.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace contactvi {

namespace {

constexpr double kUnbounded = std::numeric_limits<double>::infinity();

double bound(const VecX& bounds, int d) { return bounds.size() > 0 ? bounds[d] : kUnbounded; }

}  // namespace

ClearStep::ClearStep(const Scene& scene, int stages)
    : scene_(&scene), guards_(scene), path_(scene.tree, stages), bound_(scene.tree.nv), change_(scene.tree.nv) {}

bool ClearStep::check(const PublicStep& step, Integrator& integrator, const StepInputs& inputs, double h) {
  return actuators_are_free(step, integrator, inputs) && guards_are_open(step, integrator, h);
}

// Efforts are limited at the start of a step, those of servos at its stages as well.
bool ClearStep::actuators_are_free(const PublicStep& step, const Integrator& integrator,
                                   const StepInputs& inputs) const {
  const Elements& e = scene_->tree.elements;
  const Servo& servo = inputs.servo;
  if (!servo.any && e.effort.size() == 0 && e.speed.size() == 0) return true;
  for (const Joint& joint : scene_->tree.joints) {
    if (joint.nv != 1) continue;
    const int d = joint.iv;
    const bool driven = servo.any && (servo.kp[d] != 0.0 || servo.kd[d] != 0.0);
    const double most = std::min(bound(e.effort, d), driven ? bound(e.servo_effort, d) : kUnbounded);
    const double own = inputs.tau.size() > 0 ? inputs.tau[d] : 0.0;
    double follow = driven ? servo.kd[d] * (servo.v_ref[d] - step.v0[d]) : 0.0;
    if (driven && servo.kp[d] != 0.0) follow += servo.kp[d] * joint_error(joint, step.q0, servo.q_ref[d]);
    double largest = std::abs(own + follow);
    for (int i = 0; driven && i < integrator.stages(); ++i)
      largest = std::max(largest, std::abs(own + integrator.servo_torque(d, i)));
    if (!(largest <= most) || std::abs(step.v0[d]) >= bound(e.speed, d)) return false;
  }
  return true;
}

bool ClearStep::guards_are_open(const PublicStep& step, Integrator& integrator, double h) {
  if (guards_.count() == 0) return true;
  path_.set(step.q0, h, integrator.rates());
  if (path_.stages() > 1) {
    path_.raise(step.v0, step.v1);
    path_.bound(bound_);
    path_.doubt(change_);
    bound_ += change_;
  } else {
    // The velocities reach from v0 to 2 v - v0, v that in the middle.
    path_.bound(bound_);
    path_.chart_rate(0.5, change_);
    change_ -= step.v0;
    add_size(scene_->tree, change_, 2.0, bound_);
  }
  guards_.restart();
  guards_.bound_motion(step.q0, bound_, h);
  guards_.place(step.q1);
  for (const BroadPhase::NearPair& pair : guards_.near_pairs())
    if (!is_open(pair.guard)) return false;
  for (int g = static_cast<int>(scene_->pairs.size()); g < guards_.count(); ++g)
    if (!is_open(g)) return false;
  return true;
}

// The gap at the end is larger than all that the bodies have moved.
bool ClearStep::is_open(int guard) {
  const double gap = guards_.evaluate(guard, contact_);
  return gap > guards_.motion(guard) + Guards::kTouching;
}

}  // namespace contactvi

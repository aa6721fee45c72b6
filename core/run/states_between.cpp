#include "run/states_between.hpp"

namespace contactvi {

namespace {
constexpr int kMostParts = 16;  // in which a step may be solved
constexpr int kMostIterations = 100;

// The servos of a run; none where there are no references. Moving ones are still to be referred to a time.
Servo servos_of(const Tree& tree, const KeptRun& run) {
  const Elements& e = tree.elements;
  Servo servo;
  const Servo& used = run.state.actuators.servo;
  if (e.servo_kp.size() == 0 || used.q_ref.size() == 0) return servo;
  servo.any = true;
  servo.kp = e.servo_kp;
  servo.kd = e.servo_kd;
  servo.q_ref = used.q_ref;
  servo.v_ref = used.v_ref;
  servo.feed = VecX::Zero(tree.nv);
  if (run.references) servo.moving = &run.references;
  return servo;
}

bool limits_actuators(const Tree& tree) {
  const Elements& e = tree.elements;
  const auto any = [](const VecX& limits) { return limits.size() > 0 && limits.array().isFinite().any(); };
  return e.servo_kp.size() > 0 && (any(e.servo_effort) || any(e.effort) || any(e.speed));
}
}  // namespace

StatesBetween::StatesBetween(const Scene& scene, const SimulatorOptions& options, const KeptRun& run)
    : paths_(scene.tree, options.stages, arrays_of(run.recording.segments)),
      guide_(scene.tree, arrays_of(run.recording.segments), impact_times(run.recording)),
      integrator_(scene.tree, options.stages, options.tol, std::max(options.max_iterations, kMostIterations),
                  keeps_constraints(scene.tree, options)),
      servo_(servos_of(scene.tree, run)),
      has_branches_(limits_actuators(scene.tree)),
      tol_(options.tol),
      p_(scene.tree.nv),
      unused_(scene.tree.nv) {
  integrator_.set_servo(&servo_);
}

bool StatesBetween::advance(double step, double begin, double h, VecX& q, VecX& p) {
  if (servo_.moving != nullptr) servo_.refer(step);
  const VecX q0 = q, p0 = p;
  VecX q1(q.size()), p1(p.size());
  for (int parts = 1; parts <= kMostParts; parts *= 2) {
    const double length = h / parts;
    q = q0;
    p = p0;
    int solved = 0;
    for (; solved < parts; ++solved) {
      integrator_.forget();
      integrator_.set_time(begin + solved * length);
      integrator_.lead(&guide_, begin + solved * length);
      if (!integrator_.solve(q, p, length, VecX())) break;
      integrator_.finish(q1, p1);
      q = q1;
      p = p1;
    }
    if (solved == parts) return true;
  }
  return false;
}

StatesBetween::Found StatesBetween::find(double time, VecX& q) {
  const Eigen::Index segment = paths_.at(time);
  const double begin = paths_.start(segment);
  if (!has_branches_ && !paths_.persistent(segment) && paths_.step_to(time) > 0.0) {
    q = paths_.q(segment);
    p_ = paths_.p(segment);
    if (advance(begin, begin, time - begin, q, p_)) return Found::kMomentum;
  }
  if (servo_.moving != nullptr) servo_.refer(begin);
  return paths_.state(time, integrator_, q, p_) ? Found::kVelocity : Found::kNothing;
}

bool StatesBetween::state(double time, VecX& q, VecX& p) {
  if (!servo_.any && !has_branches_) return paths_.momentum(time, tol_, integrator_, q, p);
  const Found found = find(time, q);
  if (found == Found::kVelocity)
    integrator_.dynamics(q, p_, p, unused_);
  else
    p = p_;
  return found != Found::kNothing;
}

}  // namespace contactvi

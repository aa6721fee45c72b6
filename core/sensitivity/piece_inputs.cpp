#include "sensitivity/piece_inputs.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/gauss.hpp"

namespace contactvi {

namespace {

// Of the sizes of the terms of a closing speed: the derivative of the time of an impact grows like its inverse, so that
// below it nine of sixteen digits are lost and differences of runs no longer see the same impacts.
constexpr double kGrazing = 1e-6;

// Whether anything but inertia, gravity and springs acts, so that the energy changes between impacts.
bool does_work(const Tree& tree, const RecordedRun& run) {
  const Elements& e = tree.elements;
  const bool inputs = run.tau.size() > 0 && !run.tau.isZero(0);
  return tree.has_damping || !e.friction_dofs.empty() || inputs || e.servo_kp.size() > 0 || !e.wrenches.empty() ||
         !e.forces.empty() || !e.path_springs.empty() || !e.compliances.empty();
}

// Of the actuator of a joint; infinite: none.
double effort_limit(const Elements& e, int d) {
  const bool driven = e.servo_kp.size() > 0 && (e.servo_kp[d] != 0.0 || e.servo_kd[d] != 0.0);
  const double none = std::numeric_limits<double>::infinity();
  return std::min(e.effort.size() > 0 ? e.effort[d] : none, driven ? e.servo_effort[d] : none);
}

}  // namespace

PieceInputs::PieceInputs(const Tree& tree, const RecordedRun& run) : tree_(&tree), run_(&run) {
  const Elements& e = tree.elements;
  for (const Joint& joint : tree.joints)
    if (joint.nv == 1 && std::isfinite(effort_limit(e, joint.iv))) limited_.push_back(joint.iv);
  if (e.servo_kp.size() == 0 && limited_.empty()) return;
  servo_.any = true;
  servo_.kp = e.servo_kp.size() > 0 ? e.servo_kp : VecX(VecX::Zero(tree.nv));
  servo_.kd = e.servo_kp.size() > 0 ? e.servo_kd : servo_.kp;
  servo_.feed = VecX::Zero(tree.nv);
  servo_.q_ref = servo_.v_ref = VecX::Zero(tree.nv);
}

void PieceInputs::set(const Piece& piece) {
  if (run_->tau.rows() > 0) tau_ = run_->tau.row(piece.step).transpose();
  if (!servo_.any) return;
  if (run_->target.rows() > 0) {
    const Eigen::Index n = servo_.q_ref.size();
    servo_.q_ref = run_->target.row(piece.step).head(n).transpose();
    servo_.v_ref = run_->target.row(piece.step).tail(n).transpose();
  }
  if (!limited_.empty()) limit(piece);
}

// Smooth pieces end where an actuator comes to its limit or leaves it, so that all stages of one tell the same; that
// which is farthest from the limit does so beyond rounding. In steps with contact none was at its limit, or the run has
// no derivative.
void PieceInputs::limit(const Piece& piece) {
  const Elements& e = tree_->elements;
  const bool servos = e.servo_kp.size() > 0;
  for (const int d : held_) {
    servo_.kp[d] = servos ? e.servo_kp[d] : 0.0;
    servo_.kd[d] = servos ? e.servo_kd[d] : 0.0;
    servo_.feed[d] = 0.0;
  }
  held_.clear();
  servo_.held.assign(static_cast<std::size_t>(tree_->nv), 0);
  if (piece.persistent && piece.held == nullptr) return;
  const int s = static_cast<int>(piece.velocities.cols());
  const GaussTable& table = gauss_table(s);
  for (const int d : limited_) {
    const Joint& joint = tree_->joints[static_cast<std::size_t>(tree_->dof_joint[d])];
    const double own = tau_.size() > 0 ? tau_[d] : 0.0, most = effort_limit(e, d);
    const double error = servo_.kp[d] != 0.0 ? joint_error(joint, piece.q, servo_.q_ref[d]) : 0.0;
    double over = 0.0, asked = 0.0;
    for (int i = 0; i < s; ++i) {
      double moved = 0.0;
      for (int j = 0; j < s; ++j) moved += piece.h * table.A[i][j] * piece.velocities(d, j);
      const double effort =
          own + servo_.kp[d] * (error - moved) + servo_.kd[d] * (servo_.v_ref[d] - piece.velocities(d, i));
      if (std::abs(std::abs(effort) - most) < std::abs(over)) continue;
      over = std::abs(effort) - most;
      asked = effort;
    }
    if (!(over > 0.0)) continue;
    held_.push_back(d);
    servo_.held[static_cast<std::size_t>(d)] = 1;
    servo_.kp[d] = servo_.kd[d] = 0.0;
    servo_.feed[d] = std::copysign(most, asked) - own;
  }
}

double check_closing(const RecordedImpact& impact, double speed, double size) {
  const double approach = size > 0.0 ? std::abs(speed) / size : 0.0;
  if (approach > kGrazing) return approach;
  throw NoDerivative({"grazing", impact.guard, impact.time}, "An impact is grazing: its time has no derivative",
                     "a closing speed", std::to_string(speed) + " (unit of the gap per second)", "Start elsewhere");
}

void check_map(const Tree& tree, const RecordedRun& run, const RecordedImpact& impact) {
  if (run.map == ImpactMap::kCtec) return;
  if (impact.fallback != Fallback::kNone)
    throw NoDerivative({"map", impact.guard, impact.time}, "An implicit impact map had no answer and took another",
                       "an impact that the map itself determines", "a fallback", "Use impact='ctec'");
  if (does_work(tree, run))
    throw NoDerivative({"map", impact.guard, impact.time},
                       "An implicit impact map conserves an energy that forces change",
                       "gravity and springs alone with 'mhc' and 'dtec'",
                       "damping, joint friction, inputs or other forces", "Use impact='ctec'");
}

bool is_node(const RecordedRun& run, double time) {
  const double steps = (time - run.t0) / run.dt;
  return std::abs(steps - std::round(steps)) <= kSameTime;
}

bool starts_anew(const RecordedRun& run, std::size_t i) {
  return i == 0 || run.pieces[i - 1].end != PieceEnd::kEvent || run.pieces[i - 1].step != run.pieces[i].step;
}

}  // namespace contactvi

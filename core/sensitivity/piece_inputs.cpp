#include "sensitivity/piece_inputs.hpp"

#include <cmath>

namespace contactvi {

namespace {

constexpr double kLater = 0.381966;  // of a step: a time at which a periodic force is unlikely to be what it was

// Of the sizes of the terms of a closing speed: the derivative of the time of an impact grows like its inverse, so that
// below it nine of sixteen digits are lost and differences of runs no longer see the same impacts.
constexpr double kGrazing = 1e-6;

// Whether anything but inertia, gravity and springs acts, so that the energy changes between impacts.
bool does_work(const Tree& tree, const RecordedRun& run) {
  const Elements& e = tree.elements;
  const bool inputs = run.tau.size() > 0 && !run.tau.isZero(0);
  return tree.has_damping || !e.friction_dofs.empty() || inputs || e.servo_kp.size() > 0 || !e.wrenches.empty() ||
         !e.forces.empty() || !e.path_springs.empty();
}

// Whether a force may depend on time explicitly.
bool depends_on_time(const Elements& e) {
  bool found = !e.forces.empty();
  for (const AppliedWrench& wrench : e.wrenches) found |= static_cast<bool>(wrench.signal);
  return found;
}

}  // namespace

PieceInputs::PieceInputs(const Tree& tree, const RecordedRun& run) : run_(&run) {
  const Elements& e = tree.elements;
  if (e.servo_kp.size() == 0) return;
  servo_.any = true;
  servo_.kp = e.servo_kp;
  servo_.kd = e.servo_kd;
  servo_.feed = VecX::Zero(tree.nv);
  servo_.q_ref = servo_.v_ref = VecX::Zero(tree.nv);
}

void PieceInputs::set(const Piece& piece) {
  if (run_->tau.rows() > 0) tau_ = run_->tau.row(piece.step).transpose();
  if (!servo_.any || run_->target.rows() == 0) return;
  const Eigen::Index n = servo_.q_ref.size();
  servo_.q_ref = run_->target.row(piece.step).head(n).transpose();
  servo_.v_ref = run_->target.row(piece.step).tail(n).transpose();
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

void check_forces_in_time(const Tree& tree, const RecordedRun& run, StepEquations& equations, const Piece& piece) {
  if (!depends_on_time(tree.elements)) return;
  ForceField field(tree);
  VecX first = VecX::Zero(tree.nv), second = first, size = first, v(tree.nv);
  if (!equations.node_velocity(piece.q, piece.p, v)) throw Error("the mass matrix is not positive definite");
  field.add(piece.t, piece.q, v, first, size);
  field.add(piece.t + kLater * run.dt, piece.q, v, second, size);
  if (first == second) return;
  throw NoDerivative({"time", -1, piece.t}, "A force that depends on time acts beside an impact, whose time moves",
                     "forces of q and v alone where there are impacts", "a force that changes with time",
                     "Give the force as control, which is constant over each step");
}

bool is_node(const RecordedRun& run, double time) {
  const double steps = (time - run.t0) / run.dt;
  return std::abs(steps - std::round(steps)) <= kSameTime;
}

bool starts_anew(const RecordedRun& run, std::size_t i) {
  return i == 0 || run.pieces[i - 1].end != PieceEnd::kEvent || run.pieces[i - 1].step != run.pieces[i].step;
}

}  // namespace contactvi

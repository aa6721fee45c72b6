// DenseStep: constraints, as equations beside the laws of contact.
#include "contact/dense_step.hpp"
#include "model/constraint_check.hpp"
#include "model/constraints.hpp"
#include "model/coupling.hpp"
#include "step/path.hpp"

namespace contactvi {

namespace {
constexpr double kMet = 1e-14;  // of the coordinates: what constraints are closed to
}  // namespace

void DenseStep::evaluate(const VecX& q, double t, Constraints& node) {
  guards_->place(q);
  evaluate_constraints(scene_->tree, guards_->placements(), q, t, node.phi, node.W, node.rate);
  node.whole = node.W;
  project_rows(scene_->tree, node.W);
}

// Newton's method for the constraints at the end of the step with the velocity v_. Returns the largest change of v_.
double DenseStep::hold_constraints() {
  integrate(scene_->tree, q0_, v_, h_, q1_);
  evaluate(q1_, t_ + h_, end_);
  if (end_.phi.lpNorm<Eigen::Infinity>() <= kMet * (1.0 + q1_.lpNorm<Eigen::Infinity>())) return 0.0;
  work_ = v_;
  solver_.project(start_.W.transpose() * v_ - end_.phi / h_, v_);
  work_ = v_ - work_;
  start_.mu += solver_.multipliers(momentum(work_));
  set_start_momentum();
  integrator_.add_velocity(work_);
  return work_.lpNorm<Eigen::Infinity>();
}

// M v with the masses of the present problem.
VecX DenseStep::momentum(const VecX& v) const {
  const BlockProblem& problem = rows_.problem();
  VecX p(v.size());
  for (int b = 0; b < problem.blocks(); ++b)
    p.segment(problem.start[b], problem.size(b)) = problem.M[b] * v.segment(problem.start[b], problem.size(b));
  return p;
}

// The impulses of the constraints that change the velocities by dv beside those of the present problem.
VecX DenseStep::multipliers(const VecX& dv, const VecX& lambda) const {
  if (!constrained()) return VecX();
  VecX p = momentum(dv);
  rows_.add_impulses(-lambda, p);
  project_rows(scene_->tree, p);
  return solver_.multipliers(p);
}

// The forces of a constraint that depends on time have power: the velocities of its rows are -rate.
double DenseStep::constraint_work() const { return -start_.mu.dot(start_.rate) - end_.mu.dot(end_.rate); }

double DenseStep::driven_work() const {
  double work = constraint_work();
  if (scene_->surface_motions.empty()) return work;
  for (const DenseContact& c : contacts()) {
    if (!guards_->moves(c.point.guard)) continue;
    work -= c.position.tail<2>().dot(c.drift0) + c.velocity.tail<2>().dot(c.drift1);
    work -= c.position_turning.dot(c.turning_drift0) + c.velocity_turning.dot(c.turning_drift1);
  }
  return work;
}

// The impulses of the constraints at the end, of which p1_ is without. Driven constraints move by the mean of their
// speeds at both ends, the trapezoid of which driven_work() is the work, and the bodies by the step: returns what these
// differ by [J].
double DenseStep::take_reactions() {
  work_ = momentum(v1_) - p1_;
  project_rows(scene_->tree, work_);
  end_.mu = solver_.multipliers(work_);
  p1_ += end_.whole * end_.mu;
  const VecX mean = 0.5 * ((start_.W + end_.W).transpose() * v_ + start_.rate + end_.rate);
  return std::abs((start_.mu + end_.mu).dot(mean));
}

bool DenseStep::constraints_met() {
  const Elements& elements = scene_->tree.elements;
  violated_constraint_ =
      find_violated(elements, {start_.phi, end_.phi, end_.W.transpose() * v1_ + end_.rate, constraint_reach(q1_),
                               1.0 + v1_.cwiseAbs().maxCoeff() + end_.rate.cwiseAbs().maxCoeff(), 0.0});
  if (violated_constraint_ < 0)
    violated_constraint_ = find_jump(elements, end_.W.transpose() * v_, start_.rate, end_.rate, h_);
  return violated_constraint_ < 0;
}

}  // namespace contactvi

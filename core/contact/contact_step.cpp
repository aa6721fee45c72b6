#include "contact/contact_step.hpp"

#include <algorithm>
#include <cmath>

#include "contact/delassus.hpp"
#include "model/step_costs.hpp"

namespace contactvi {

namespace {
constexpr int kMaxIterations = 40;
constexpr double kRounding = 1e-14;  // of the velocities: converged
// [m] of gaps, of those to cylinders and ellipsoids, and of constraints; divided by the step it is a velocity
constexpr double kGapRounding = 2e-16, kLargerRounding = 1e-15;
constexpr double kShare = 0.1;            // of what rounding of gaps makes: iterations leave no more of the velocities
constexpr double kPlaceRounding = 4e-15;  // [m] by which positions of sticking points disagree
// Residual of a cone problem that counts as solved: while the iterations go on, and when they have settled. Redundant
// rows agree only as far as the iterations have come; better impulses would press the points of a body against each
// other.
constexpr double kAcceptFirst = 1e-7, kAccept = 1e-9;
constexpr double kAcceptShare = 1e-2;  // of the last change of the velocities, relative: in between
// Relative disagreement of dependent rows: at first, when settled.
constexpr double kAgreeFirst = 1e-4, kAgreeSettled = 1e-7;
constexpr double kShortRim = 1e-9, kShort = 1e-5;  // of a nominal step; see counts_by_rate
constexpr double kStalled = 1e3;                   // of the convergence limit: iterations that stall below it end
constexpr int kIdle = 4;                           // iterations without gain that count as a stall
constexpr double kBest = 1e-4;                     // smallest contraction rate that is assumed
constexpr double kRemembered = 10.0;               // times the contraction seen in an earlier step: that of this one
constexpr double kSameTime = 1e-13;                // of 1 s + t: times that differ less are equal
constexpr double kSettled = 1e-3;                  // relative change of v from which on the contact matrix is kept
}  // namespace

ContactStep::ContactStep(const Scene& scene, Guards& guards, const Manifolds& manifolds)
    : scene_(&scene),
      guards_(&guards),
      manifolds_(&manifolds),
      geometry_(guards),
      integrator_(scene.tree),
      costs_(scene.tree),
      bilateral_(scene.tree.elements.constraint_rows),
      friction_rows_(static_cast<int>(scene.tree.elements.friction_dofs.size())),
      v_(scene.tree.nv),
      p_start_(scene.tree.nv),
      p_minus_(scene.tree.nv),
      p_given_(VecX::Zero(scene.tree.nv)),
      q1_(scene.tree.nq),
      p1_(scene.tree.nv),
      v1_(scene.tree.nv),
      dv_(scene.tree.nv),
      rates_(scene.tree.nv, 1),
      guess_(scene.tree.nv),
      q_side_(scene.tree.nq),
      acceleration_(scene.tree.nv),
      v_start_(scene.tree.nv) {
  const Tree& tree = scene.tree;
  for (int dof : tree.elements.friction_dofs) {
    const Joint& joint = tree.joints[tree.dof_joint[dof]];
    friction_outcomes_.emplace_back();
    friction_joints_.push_back({dof, joint.nq == 1 ? joint.iq : -1, tree.elements.joint_friction[dof]});
  }
  restart();
}

void ContactStep::restart() {
  for (FrictionJoint& joint : friction_joints_) joint.anchored = false;
  fixed_force_.setZero(bilateral_ + friction_rows_);
}

// Sizes the rows for the present contacts.
void ContactStep::set_rows() {
  const std::size_t n = contacts_.size();
  row_.resize(n);
  cones_.resize(friction_rows_ + n);
  outcomes_.resize(n);
  reference_positions_.resize(n);
  paradox_.resize(n);
  rows_ = bilateral_ + friction_rows_;
  iterated_ = friction_varies_ = follows_forces_ = rolling_ = false;
  adheres_ = any_adhesion(*scene_, contacts_);
  node1_.known = false;  // it was that of other contacts
  for (std::size_t i = 0; i < n; ++i) {
    row_[i] = rows_;
    rows_ += contacts_[i].rows();
    cones_[friction_rows_ + i] = ConeContact();
    cones_[friction_rows_ + i].row = row_[i] - bilateral_;
    cones_[friction_rows_ + i].rows = contacts_[i].rows();
    cones_[friction_rows_ + i].mu = contacts_[i].mu;
    if (contacts_[i].rows() > 3) {
      cones_[friction_rows_ + i].spins = contacts_[i].spinning > 0.0;
      cones_[friction_rows_ + i].rolling = contacts_[i].rolling > 0.0 ? 1.0 : 0.0;  // its rows are times the radius
      rolling_ |= contacts_[i].rolling > 0.0;
    }
    const int guard = contacts_[i].point.guard;
    iterated_ |= scene_->is_pair(guard) && scene_->pairs[guard].refined;
    friction_varies_ |= scene_->friction_varies(guard);
    follows_forces_ |= scene_->friction_by_state(guard);
  }
  const int nv = scene_->tree.nv;
  for (Node* node : {&node0_, &node1_}) {
    node->at.resize(n);
    node->t1.resize(n);
    node->side.resize(n);
    node->along.resize(n);
    node->phi.resize(bilateral_);
    node->rate.setZero(rows_);
    if (node->W.cols() != rows_ || node->W.rows() != nv) node->W.resize(nv, rows_);
  }
  if (S_.cols() == rows_) return;
  for (VecX* x : {&y_, &lambda_, &lambda_end_, &b_, &change_, &w_end_}) x->resize(rows_);
  for (MatX* X : {&DinvW_, &S_, &MinvW_}) X->resize(nv, rows_);
  G_.resize(rows_, rows_);
  G_end_.resize(rows_, rows_);
  solver_.reserve(rows_ - bilateral_);
}

// Where the point of contact i lies on its bodies, which are placed.
void ContactStep::set_place(const ContactPoint& point, std::size_t i, Node& node) const {
  const Placements& at = guards_->placements(point.guard);
  node.side[i] = Manifolds::side_of_rim(point, at);
  node.along[i] = manifolds_->place_along(point, at, node.at[i]);
}

void ContactStep::start_node(const VecCRef& q0) {
  const double t = integrator_.time();
  const bool same_time = bilateral_ == 0 || std::abs(node0_.t - t) <= kSameTime * (1.0 + std::abs(t));
  if (node0_.known && same_time && (node0_.q.array() == q0.array()).all()) return;
  set_rows();
  guards_->place(q0);
  node0_.q = q0;
  node0_.known = true;
  constraint_node(q0, t, node0_);
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    const PersistentContact& persistent = contacts_[i];
    geometry_.evaluate(persistent.point, node0_.at[i]);
    set_place(persistent.point, i, node0_);
    node0_.t1[i] = geometry_.start_tangent(persistent, node0_.at[i]);
    set_contact_rows(i, t, node0_);
    if (persistent.counts_by_place()) reference_positions_[i] = geometry_.reference(persistent);
  }
}

void ContactStep::end_node(const VecX& q1, double t1, const MotionValues& motions) {
  guards_->place(q1);
  node1_.q = q1;
  node1_.known = true;
  constraint_node(q1, t1, node1_, motions);
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    const PersistentContact& persistent = contacts_[i];
    geometry_.evaluate(persistent.point, node1_.at[i]);
    set_place(persistent.point, i, node1_);
    node1_.t1[i] = geometry_.tangent(persistent, node1_.at[i], node0_.at[i], node0_.t1[i]);
    set_contact_rows(i, t1, node1_);
  }
}

// The rows of contact i at a node, and the velocities that its surfaces have of themselves.
void ContactStep::set_contact_rows(std::size_t i, double t, Node& node) {
  const PersistentContact& persistent = contacts_[i];
  const int guard = persistent.point.guard;
  guards_->rows(guard, node.at[i], node.t1[i], node.W.middleCols(row_[i], persistent.rows()));
  if (guards_->moves(guard) && persistent.mu > 0.0)
    node.rate.segment<2>(row_[i] + 1) = guards_->surface_velocity(guard, node.at[i], node.t1[i], t);
  if (guards_->moves(guard) && persistent.rows() > 3)
    guards_->surface_turning(guard, node.at[i], node.t1[i], t,
                             node.rate.segment(row_[i] + 3, persistent.turning_rows()));
}

// Whether the gap of a contact counts in a step of length h by its rate: the difference of two gaps over so short a
// time is rounding.
bool ContactStep::counts_by_rate(const PersistentContact& persistent, double h) const {
  // The rate of a rim's gap changes as it rolls.
  const double shortest = persistent.point.kind == PointKind::kRim ? kShortRim : kShort;
  return h < shortest * nominal_h_;
}

// y_ = (phi(q1)/h; s), the velocities of the rows over the step at the velocity v_, and their derivative S_^T with
// respect to v_.
void ContactStep::set_row_velocities(double h) {
  integrate(scene_->tree, node0_.q, v_, h, q1_);
  end_node(q1_, integrator_.time() + h);
  S_ = node1_.W;
  set_constraint_velocities(h);
  const bool surfaces_move = !scene_->surface_motions.empty();
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    const PersistentContact& persistent = contacts_[i];
    const int r = row_[i];
    // The error of the gap at the start is corrected over a nominal step: a shorter one leaves its part of it.
    const double remaining = h < nominal_h_ ? (1.0 - h / nominal_h_) * node0_.at[i].gap : 0.0;
    if (counts_by_rate(persistent, h)) {
      S_.col(r) = 0.5 * (node0_.W.col(r) + node1_.W.col(r));
      y_[r] = S_.col(r).dot(v_) + node0_.at[i].gap / nominal_h_;
    } else {
      y_[r] = (node1_.at[i].gap - remaining) / h;
    }
    if (persistent.mu == 0.0) continue;
    int k = r + 1;
    if (persistent.counts_by_place()) {
      y_.segment<2>(k) = geometry_.displacement(persistent, reference_positions_[i]) / h;
      k += 2;
    }
    for (const int end = r + persistent.rows(); k < end; ++k) {
      S_.col(k) = 0.5 * (node0_.W.col(k) + node1_.W.col(k));
      y_[k] = S_.col(k).dot(v_);
      if (surfaces_move) y_[k] += 0.5 * (node0_.rate[k] + node1_.rate[k]);
    }
  }
}

// The forces of the rows from which a step starts that follows on no other: half of those of the last step, which
// belong to both its impulses.
void ContactStep::start_forces() {
  start_forces_.resize(rows_);
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    const int rows = std::min(contacts_[i].rows(), 3), turning = contacts_[i].rows() - rows;
    start_forces_.segment(row_[i], rows) = 0.5 * contacts_[i].force.head(rows);
    if (turning > 0) start_forces_.segment(row_[i] + rows, turning) = 0.5 * contacts_[i].turning_force.head(turning);
  }
  start_forces_.head(bilateral_ + friction_rows_) = 0.5 * fixed_force_;
}

bool ContactStep::solve_cone(const ConeProblem& problem, VecX& lambda, bool regularize) {
  const ConeResult result = solver_.solve(problem, lambda, regularize);
  ++counters.problems;
  counters.iterations += result.iterations;
  counters.cost += result.factors * costs::cone_iteration(static_cast<double>(lambda.size()));
  counters.fallbacks += result.fallbacks;
  residual_ = result.ok ? 0.0 : result.residual;
  return residual_ <= problem.accept;
}

// Start values of the position impulses, the bounds of joint friction, and the
// coordinates from which the displacements of these joints count.
void ContactStep::set_initial_impulses(double h) {
  lambda_ = h * start_forces_;
  if (shift_.size() != rows_) shift_.setZero(rows_);
  for (int k = 0; k < friction_rows_; ++k) cones_[k] = joint_friction_cone(k, 0.5 * h * friction_joints_[k].limit);
  for (FrictionJoint& joint : friction_joints_)
    joint.reference = joint.anchored ? joint.anchor : joint.iq >= 0 ? node0_.q[joint.iq] : 0.0;
}

// Whether an impulse along the normal at the start of the step closes the same contact at its end: the point of a rim
// that passes through the plane's parallel is then on the other side, and no impulse at the start keeps the gap.
bool ContactStep::turns_over() const {
  for (std::size_t i = 0; i < contacts_.size(); ++i)
    if (!(G_(row_[i], row_[i]) > 0.0) && node0_.W.col(row_[i]).squaredNorm() > 0.0) return true;
  return false;
}

bool ContactStep::iterate(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau, const VecX& v) {
  start_node(q0);
  integrator_.begin(q0, h, tau, v);
  set_initial_impulses(h);
  if (adheres_) set_pulls(h);
  double best = INFINITY;
  int idle = 0;
  double last = INFINITY, relative = INFINITY;
  bool settled = false;
  // Of the rows, as a velocity.
  const double noise = (bilateral_ > 0 || iterated_ ? kLargerRounding : kGapRounding) / h;
  for (int k = 0; k < kMaxIterations; ++k) {
    ++counters.contact_iterations;
    counters.cost += costs_.contact_iteration(rows_);
    p_start_ = p0;
    p_start_.noalias() += node0_.W * lambda_;
    if (adheres_) p_start_.noalias() -= node0_.W * pull_;
    const double stage_change = integrator_.iterate(p_start_, k == 0, k == 0);
    if (!std::isfinite(stage_change)) break;
    if (k == 0) {
      DinvW_ = node0_.W;
      integrator_.solve_step_matrix(DinvW_);
    }
    integrator_.stage_velocity(v_);
    set_row_velocities(h);
    if (!y_.allFinite()) break;
    if (friction_varies_) follow_slips(h);
    if (!settled) {
      delassus(S_, DinvW_, G_);
      if (turns_over()) {
        why_ = "a contact point moves to the other side of a body within the step";
        return false;
      }
      if (bilateral_ > 0) reduction_.set(G_, bilateral_, friction_rows_);
    }
    b_ = y_;
    b_.noalias() -= G_ * lambda_;
    change_ = lambda_;
    const Agreement agreement =
        settled ? Agreement{kAgreeSettled, std::clamp(kAcceptShare * relative, kAccept, kAcceptFirst)}
                : Agreement{kAgreeFirst, kAcceptFirst};
    // Over so short a time impulses close rounding of gaps.
    const bool usual = k == 0 && h >= kShort * nominal_h_;
    if (usual) lambda_ += h * shift_;
    const bool solved = solve_rows(cones_, G_, b_, std::max(noise, kPlaceRounding / h), lambda_, k == 0, agreement);
    if (usual) note_shift(h);
    if (k == 0) find_paradox();
    if (!solved) {
      why_ = "the contact forces were not found";
      return false;
    }
    change_ = lambda_ - change_;
    dv_.noalias() = DinvW_ * change_;
    integrator_.add_velocity(dv_);
    const double size = 1.0 + v_.cwiseAbs().maxCoeff(), change = std::max(stage_change, dv_.cwiseAbs().maxCoeff());
    if (!std::isfinite(change)) break;
    const double floor = std::max(kRounding, noise) * size, most_left = std::max(kRounding, kShare * noise) * size;
    relative = change / size;
    settled = relative < kSettled;
    // The change of the next iteration is estimated by the contraction rate, at first by that of an earlier step.
    if (k == 1) note_contraction(change, last, floor);
    const double theta = k > 0 ? std::max(kBest, change / last) : kRemembered * std::max(kBest, contraction_);
    last = change;
    const bool accepted = residual_ <= kAccept;
    if (accepted && (change <= floor || (theta < 0.5 && change * theta / (1.0 - theta) <= most_left))) {
      solved_forces_ = lambda_ / h;
      return true;
    }
    idle = change < 0.7 * best ? 0 : idle + 1;
    best = std::min(best, change);
    if (accepted && idle >= kIdle && best < kStalled * floor) {
      solved_forces_ = lambda_ / h;
      return true;
    }
    if (idle >= 4 * kIdle) break;
  }
  why_ = "the step with persistent contacts does not converge";
  if (node1_.known) constraints_met(h, false);
  return false;
}

// By what the start of the next problem like the one just solved differs from its impulses (ConeSolver::shift).
void ContactStep::note_shift(double h) {
  shift_.setZero(rows_);
  const auto shift = solver_.shift();
  // Constraints alone ask for no solver.
  if (rows_ > bilateral_ && shift.size() > 0) shift_.tail(rows_ - bilateral_) = shift / h;
}

// The adhesion of a step of length h, half of it at each end.
void ContactStep::set_pulls(double h) {
  const double t = integrator_.time();
  pull_.setZero(rows_);
  pull_end_.setZero(rows_);
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    pull_[row_[i]] = 0.5 * h * adhesion(*scene_, contacts_[i], t);
    pull_end_[row_[i]] = 0.5 * h * adhesion(*scene_, contacts_[i], t + h);
  }
}

// The friction of contacts that slide is that of their speed over the step, of those that stick that of rest. Where it
// depends on the force, each impulse has that of its own: the mean force over half of the step.
void ContactStep::follow_slips(double h) {
  friction_states_.clear();
  const double middle = integrator_.time() + 0.5 * h;
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    const bool varies = scene_->friction_varies(contacts_[i].point.guard);
    const double speed = varies ? frame(i, node1_).slip(y_.segment<2>(row_[i] + 1)).norm() : 0.0;
    friction_states_.push_back({contacts_[i].point.guard, contacts_[i].sticks, speed, 2.0 * lambda_[row_[i]] / h,
                                middle, cones_[friction_rows_ + i].mu});
  }
  set_friction(*scene_, friction_states_);
  for (std::size_t i = 0; i < contacts_.size(); ++i) cones_[friction_rows_ + i].mu = friction_states_[i].mu;
}

// The second iteration of a step has made a change, the first one has made another one. Where the second is of the size
// of rounding it shows a bound on the contraction alone.
void ContactStep::note_contraction(double second, double first, double rounding) {
  if (second > kStalled * rounding)
    contraction_ = second / first;
  else
    contraction_ = std::min(contraction_, std::max(second, rounding) / first);
}

bool ContactStep::solve(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) {
  why_ = "";
  violated_constraint_ = -1;
  const bool follows = node0_.known && follows_ && (node0_.q.array() == q0.array()).all();
  if (follows) {
    velocities_.predict(h, guess_);
    v_start_ = v_node_;
  } else {
    if (!integrator_.node_velocity(q0, p0, v1_)) {
      why_ = "the mass matrix is not positive definite";
      return false;
    }
    guess_ = v_start_ = v1_;
  }
  start_node(q0);
  if (follows)
    row_forces_.predict(h, start_forces_);
  else
    start_forces();
  p_given_ = p0;
  start_joint_friction(v_start_);
  h_ = h;
  ++counters.steps;
  counters.cost += costs_.contact_step();
  forget_parts();
  if (!iterate(q0, p0, h, tau, guess_) || !velocity_impulses()) return false;
  part_velocities_.add(0.0, v_start_);
  note_part();
  return true;
}

void ContactStep::forget_parts() {
  part_velocities_.clear();
  part_forces_.clear();
  shows_part_ = false;
}

// The part just solved, from which others start.
void ContactStep::note_part() {
  part_velocities_.add(h_, v_);
  part_forces_.add(h_, solved_forces_);
  shows_part_ = true;
}

bool ContactStep::solve_part(const StepPath& path, double alpha, const VecCRef& q0, const VecCRef& p0,
                             const VecX& tau) {
  why_ = "";
  const double h = alpha * path.h();
  if (shows_part_ && h == h_) return true;
  h_ = h;
  shows_part_ = false;
  bool solved = false;
  if (!part_forces_.empty()) {
    part_velocities_.value(h, guess_);
    part_forces_.value(h, start_forces_);
    solved = iterate(q0, p0, h, tau, guess_) && velocity_impulses();
  }
  if (!solved) {
    path.velocity(0.5 * alpha, guess_);
    start_forces_ = solved_forces_;
    solved = iterate(q0, p0, h, tau, guess_) && velocity_impulses();
  }
  if (solved) note_part();
  return solved;
}

void ContactStep::finish(VecRef q1, VecRef p1) {
  q1 = q1_;
  p1 = p1_;
}

bool ContactStep::node_velocity(const VecCRef& q, const VecCRef& p, VecRef v) {
  const bool at_start = node0_.known && q == node0_.q && p == p_given_;
  if (!at_start) {
    shows_part_ = false;
    return integrator_.node_velocity(q, p, v);
  }
  v = v_start_;
  return true;
}

const MatX& ContactStep::rates() {
  rates_.col(0) = v_;
  return rates_;
}

}  // namespace contactvi

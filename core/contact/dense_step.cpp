#include "contact/dense_step.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "base/tolerances.hpp"
#include "model/point_jacobian.hpp"
#include "step/energy.hpp"
#include "step/path.hpp"

namespace contactvi {

namespace {
constexpr int kStageIterations = 40;
constexpr double kStageRounding = 1e-14;  // of the velocities: the smooth equation is solved
constexpr double kStageStalled = 1e-10;   // of the velocities: accepted where rounding stops the iterations
constexpr int kGapIterations = 30;
constexpr double kGapSolved = 1e-11;       // [m] to which gaps of loaded contacts are zero
constexpr double kGapPromised = 1e-10;     // [m] overlap at the end from which on a point joins the candidates
constexpr double kSamePoint = 1e-7;        // [m] points of one feature nearer to each other are one
constexpr int kAdditions = 8;              // times that points join the candidates of one step
constexpr double kTouching = 1e-11;        // [m] a closed point without load takes part in the velocity impulse
constexpr double kFastFall = 4.0;          // contacts that close faster than this many g h have restitution
constexpr double kWider = 1.5;             // of the motion's bound, where the step has left it
constexpr double kEnergyRounding = 1e-13;  // of the energies
constexpr double kEnergyShare = 1e-8;      // of the kinetic energy: smaller gains are not worth a shorter step

Vec3 world_turned(const Placements& at, int body, const Vec3& x) { return body < 0 ? x : Vec3(at.R_W[body] * x); }
Vec3 body_point(const Placements& at, int body, const Vec3& x_W) {
  return body < 0 ? x_W : Vec3(at.R_W[body].transpose() * (x_W - at.p_W[body]));
}

// An answer that meets Coulomb's law to 1e-4 of the largest free speed is below the error of the step where impacts lie
// inside of it; where none do the sweeps and Newton's method reach 1e-8.
BlockOptions solver_options() {
  BlockOptions options;
  options.accept = 1e-4;
  options.factors = 12;
  return options;
}

double potential_scale(const Energy& e) { return std::abs(e.kinetic) + std::abs(e.potential); }
}  // namespace

Vec3 DenseContact::position_W() const {
  return position[0] * at0.normal + position[1] * t1_0 + position[2] * at0.normal.cross(t1_0);
}

Vec3 DenseContact::velocity_W() const {
  return velocity[0] * at1.normal + velocity[1] * t1_1 + velocity[2] * at1.normal.cross(t1_1);
}

DenseStep::DenseStep(const Scene& scene, Guards& guards) : scene_(&scene), guards_(&guards), integrator_(scene.tree) {
  const Tree& tree = scene.tree;
  for (VecX* x : {&p0_, &v0_, &v_free_, &v_, &v1_, &p1_, &p_start_, &bound_, &w_}) *x = VecX::Zero(tree.nv);
  for (VecX* x : {&q0_, &q1_}) x->setZero(tree.nq);
  // Blocks: the subtrees of the world's children, whose degrees of freedom follow each other.
  int largest = 0;
  problem_.start = {0};
  for (std::size_t j = 0; j < tree.joints.size(); ++j) {
    const int parent = tree.joints[j].parent;
    if (parent >= 0) {
      tree_of_joint_.push_back(tree_of_joint_[parent]);
      if (tree_of_joint_.back() != static_cast<int>(problem_.start.size()) - 2)
        throw Error("the joints of a tree do not follow each other");
    } else {
      problem_.start.push_back(problem_.start.back());
      tree_of_joint_.push_back(static_cast<int>(problem_.start.size()) - 2);
    }
    problem_.start.back() = tree.joints[j].iv + tree.joints[j].nv;
  }
  for (int b = 0; b < problem_.blocks(); ++b) {
    largest = std::max(largest, problem_.size(b));
    problem_.M.emplace_back(problem_.size(b), problem_.size(b));
  }
  columns_.resize(tree.nv, largest);
  problem_.v_free.setZero(tree.nv);
  restart();
}

void DenseStep::restart() {
  memory_.change.resize(0);
  memory_.impulses.clear();
  memory_.joint_friction.setZero(static_cast<Eigen::Index>(scene_->tree.elements.friction_dofs.size()));
  memory_.closed.clear();
}

// --- the smooth equation ---

bool DenseStep::iterate_stage() {
  double last = INFINITY;
  for (int k = 0; k < kStageIterations; ++k) {
    const double change = integrator_.iterate(p_start_, false, false);
    if (!std::isfinite(change)) break;
    integrator_.stage_velocity(v_);
    const double size = 1.0 + v_.cwiseAbs().maxCoeff();
    if (change <= kStageRounding * size) return true;
    if (change > 0.5 * last && change <= kStageStalled * size) return true;
    last = change;
  }
  why_ = "the smooth equation of a dense step was not solved";
  return false;
}

bool DenseStep::solve_smooth(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) {
  q0_ = q0;
  p0_ = p0;
  h_ = h;
  if (!integrator_.node_velocity(q0, p0, v0_)) {
    why_ = "the mass matrix is not positive definite";
    return false;
  }
  integrator_.begin(q0, h, tau, v0_);
  p_start_ = p0;
  if (!std::isfinite(integrator_.iterate(p_start_, true, true))) {
    why_ = "a number is not finite";
    return false;
  }
  if (!iterate_stage()) return false;
  v_free_ = v_;
  return true;
}

// The inverse blocks are in columns_; M of the problem becomes their inverses.
void DenseStep::invert_blocks() {
  for (int b = 0; b < problem_.blocks(); ++b) {
    const int n = problem_.size(b);
    MatX inverse = columns_.block(problem_.start[b], 0, n, n);
    inverse = 0.5 * (inverse + inverse.transpose().eval());
    problem_.M[b] = inverse.llt().solve(MatX::Identity(n, n));
    problem_.M[b] = 0.5 * (problem_.M[b] + problem_.M[b].transpose().eval());
  }
}

void DenseStep::make_step_blocks() {
  columns_.setZero();
  for (int b = 0; b < problem_.blocks(); ++b)
    for (int d = 0; d < problem_.size(b); ++d) columns_(problem_.start[b] + d, d) = 1.0;
  integrator_.solve_step_matrix(columns_);
  invert_blocks();
}

void DenseStep::make_node_blocks() {
  columns_.setZero();
  for (int b = 0; b < problem_.blocks(); ++b)
    for (int d = 0; d < problem_.size(b); ++d) columns_(problem_.start[b] + d, d) = 1.0;
  integrator_.solve_masses(columns_);
  invert_blocks();
}

// --- candidates ---

// The pairs that may close in the step, with their points at its start, as far as they are not known yet. bound_: of
// the velocities in the step.
void DenseStep::collect(const VecCRef& q0) {
  // The list is made anew in each step: the broad phase counts on bodies that end where they are placed.
  guards_->restart();
  guards_->bound_motion(q0, bound_, h_);
  guards_->place(q0);
  candidates_.clear();
  for (const BroadPhase::NearPair& pair : guards_->near_pairs()) candidates_.push_back(pair.guard);
  for (int g = static_cast<int>(scene_->pairs.size()); g < guards_->count(); ++g) candidates_.push_back(g);
  const std::size_t known = near_.size();
  for (int g : candidates_) {
    const auto last = near_.begin() + static_cast<std::ptrdiff_t>(known);
    if (std::any_of(near_.begin(), last, [g](const Near& near) { return near.guard == g; })) continue;
    if (guards_->separated_at_end(g)) continue;
    Near near{};
    near.guard = g;
    near.gap0 = guards_->evaluate_witness(g, near.witness0);
    near.reach = guards_->motion(g);
    if (!(near.gap0 <= near.reach)) continue;
    near_.push_back(near);
    points_.clear();
    if (!scene_->is_pair(g)) {
      ContactPoint limit{};
      limit.guard = g;
      limit.kind = PointKind::kLimit;
      points_.push_back(limit);
    } else {
      guards_->manifolds().find(g, guards_->placements(), near.witness0, std::max(near.gap0, 0.0) + near.reach,
                                points_);
    }
    for (const ContactPoint& point : points_) add_point(point, frozen(point, near.witness0), near.witness0);
    add_rims(near);
  }
}

// A rim that is nearly flat may touch all around within the step: material points at its quarters join the lowest one.
// The guards are placed at the start of the step.
void DenseStep::add_rims(const Near& near) {
  for (std::size_t k = 0, count = points_.size(); k < count; ++k) {
    if (points_[k].kind != PointKind::kRim) continue;
    const std::int64_t lowest = points_[k].feature;
    for (int quarter = 0; quarter < 4; ++quarter) {
      const std::int64_t feature = rim_quarter(lowest, quarter);
      const ContactPoint point = guards_->manifolds().point(near.guard, guards_->placements(), near.witness0, feature);
      Contact contact;
      evaluate(point, nullptr, contact);
      if (contact.gap <= std::max(near.gap0, 0.0) + near.reach &&
          guards_->manifolds().is_over_face(point, guards_->placements()))
        add_point(point, point, near.witness0);
    }
  }
}

void DenseStep::evaluate(const ContactPoint& point, const Contact* witness, Contact& contact) {
  if (point.kind != PointKind::kWitness && point.kind != PointKind::kLimit)
    guards_->manifolds().evaluate(point, guards_->placements(), contact);
  else if (witness != nullptr)
    contact = *witness;
  else
    guards_->evaluate_witness(point.guard, contact);
}

// The point as the step sees it: what touches moves with the bodies. The lowest point of a rim and the witness of
// shapes with edges become a point of one body over a plane of the other, because they would run around the bodies
// within the step; another such point joins where that one leaves an overlap. The guards are placed where the point was
// found.
ContactPoint DenseStep::frozen(const ContactPoint& point, const Contact& witness) const {
  ContactPoint law = point;
  const Placements& at = guards_->placements();
  if (point.kind == PointKind::kRim) {
    const Vec3 n_W = world_turned(at, point.plane_body, point.normal_B);
    const Vec3 n = point.point_body < 0 ? n_W : Vec3(at.R_W[point.point_body].transpose() * n_W);
    law.kind = PointKind::kVertex;
    law.center_B = lowest_of_rim(point.center_B, point.axis_B, point.rim_radius, n);
  } else if (point.kind == PointKind::kWitness && !guards_->manifolds().is_single(point.guard)) {
    law.kind = PointKind::kVertex;
    law.on_b = true;
    law.radius = 0.0;
    law.point_body = witness.body_b;
    law.plane_body = witness.body_a;
    law.center_B = body_point(at, witness.body_b, witness.point_b);
    law.normal_B = witness.body_a < 0 ? witness.normal : Vec3(at.R_W[witness.body_a].transpose() * witness.normal);
    law.offset = law.normal_B.dot(body_point(at, witness.body_a, witness.point_a));
  }
  return law;
}

// A point joins the candidates, unless it is one of them. The guards are placed at the start of the step.
bool DenseStep::add_point(const ContactPoint& point, const ContactPoint& law, const Contact& witness0) {
  for (const DenseContact& c : contacts_)
    if (c.point.guard == point.guard && c.point.feature == point.feature &&
        (c.law.center_B - law.center_B).squaredNorm() < kSamePoint * kSamePoint)
      return false;
  DenseContact c{};
  c.point = point;
  c.law = law;
  c.mu = scene_->friction(point.guard);
  c.restitution = scene_->restitution(point.guard);
  evaluate(law, &witness0, c.at0);
  c.t1_0 = scene_->is_pair(point.guard) ? any_tangent(c.at0.normal) : Vec3(Vec3::Zero());
  set_start_impulses(c);
  contacts_.push_back(c);
  return true;
}

// The impulses of the last step are the start values.
void DenseStep::set_start_impulses(DenseContact& c) const {
  for (const Impulse& last : memory_.impulses) {
    if (last.guard != c.point.guard || last.feature != c.point.feature) continue;
    const Vec3 t2 = c.at0.normal.cross(c.t1_0);
    auto along = [&](const Vec3& f) { return Vec3(f.dot(c.at0.normal), f.dot(c.t1_0), f.dot(t2)); };
    const bool pair = scene_->is_pair(c.point.guard);
    c.position = h_ * (pair ? along(last.position_force) : last.position_force);
    c.velocity = h_ * (pair ? along(last.velocity_force) : last.velocity_force);
    if (c.rows() == 3) return;
    c.position.tail<2>().setZero();
    c.velocity.tail<2>().setZero();
    return;
  }
}

// --- rows ---

// Adds a body's part of a row to the coefficients of its tree, which begin at `column`.
void DenseStep::write_row(int column, int size, int first_dof, int body, const Vec3& x, const Vec3& n, double sign) {
  w_.segment(first_dof, size).setZero();
  add_point_row(scene_->tree, guards_->placements(), body, x, n, sign, w_);
  for (int d = 0; d < size; ++d) problem_.W[column + d] += w_[first_dof + d];
}

// The rows of the active contacts and of joint friction, at the start or the end of the step, where the guards are
// placed.
void DenseStep::set_rows(bool at_end) {
  const Tree& tree = scene_->tree;
  problem_.contacts.clear();
  int row = 0, column = 0;
  auto begin = [&](int a, int b, int rows) -> BlockContact& {
    BlockContact c;
    c.a = a;
    c.b = b;
    c.row = row;
    c.rows = rows;
    c.column = column;
    row += rows;
    column += rows * (problem_.size(a) + (b >= 0 ? problem_.size(b) : 0));
    problem_.W.resize(column);
    std::fill(problem_.W.begin() + c.column, problem_.W.end(), 0.0);
    problem_.contacts.push_back(c);
    return problem_.contacts.back();
  };
  for (int i : active_) {
    const DenseContact& c = contacts_[i];
    const Contact& at = at_end ? c.at1 : c.at0;
    if (!scene_->is_pair(c.point.guard)) {
      const JointLimit& limit = tree.limits[c.point.guard - scene_->pairs.size()];
      const int t = tree_of_joint_[limit.joint];
      BlockContact& block = begin(t, -1, 1);
      problem_.W[block.column + tree.joints[limit.joint].iv - problem_.start[t]] = limit.upper ? -1.0 : 1.0;
      continue;
    }
    const int tree_a = at.body_a < 0 ? -1 : tree_of_joint_[at.body_a];
    const int tree_b = at.body_b < 0 ? -1 : tree_of_joint_[at.body_b];
    const int first = tree_a >= 0 ? tree_a : tree_b, second = tree_a >= 0 && tree_b != tree_a ? tree_b : -1;
    BlockContact& block = begin(first, second, c.rows());
    block.mu = c.mu;
    const Vec3& t1 = at_end ? c.t1_1 : c.t1_0;
    const Vec3 directions[3] = {at.normal, t1, at.normal.cross(t1)};
    const int size_1 = problem_.size(first), size_2 = second >= 0 ? problem_.size(second) : 0;
    for (int r = 0; r < block.rows; ++r) {
      const int column_1 = block.column + r * size_1, column_2 = block.column + block.rows * size_1 + r * size_2;
      if (tree_a >= 0) write_row(column_1, size_1, problem_.start[first], at.body_a, at.point_a, directions[r], -1.0);
      if (tree_b < 0) continue;
      if (tree_b == first)
        write_row(column_1, size_1, problem_.start[first], at.body_b, at.point_b, directions[r], 1.0);
      else
        write_row(column_2, size_2, problem_.start[second], at.body_b, at.point_b, directions[r], 1.0);
    }
  }
  const Elements& e = tree.elements;
  for (int dof : e.friction_dofs) {
    const int t = tree_of_joint_[tree.dof_joint[dof]];
    BlockContact& block = begin(t, -1, 1);
    block.box = 0.5 * h_ * e.joint_friction[dof];
    problem_.W[block.column + dof - problem_.start[t]] = 1.0;
  }
  problem_.offset.setZero(row);
  lambda_.setZero(row);
}

namespace {

double row_velocity(const BlockProblem& problem, const BlockContact& c, int r, const VecX& v) {
  const int size_a = problem.size(c.a), size_b = c.b >= 0 ? problem.size(c.b) : 0;
  double w = 0.0;
  const double* a = problem.W.data() + c.column + r * size_a;
  for (int d = 0; d < size_a; ++d) w += a[d] * v[problem.start[c.a] + d];
  const double* b = problem.W.data() + c.column + c.rows * size_a + r * size_b;
  for (int d = 0; d < size_b; ++d) w += b[d] * v[problem.start[c.b] + d];
  return w;
}

// p += W lambda.
void add_impulses(const BlockProblem& problem, const VecX& lambda, VecX& p) {
  for (const BlockContact& c : problem.contacts) {
    const int size_a = problem.size(c.a), size_b = c.b >= 0 ? problem.size(c.b) : 0;
    for (int r = 0; r < c.rows; ++r) {
      const double* a = problem.W.data() + c.column + r * size_a;
      for (int d = 0; d < size_a; ++d) p[problem.start[c.a] + d] += lambda[c.row + r] * a[d];
      const double* b = problem.W.data() + c.column + c.rows * size_a + r * size_b;
      for (int d = 0; d < size_b; ++d) p[problem.start[c.b] + d] += lambda[c.row + r] * b[d];
    }
  }
}

}  // namespace

void DenseStep::account(const BlockResult& result) {
  report_.residual = std::max(report_.residual, result.residual);
  using Stage = BlockResult::Stage;
  report_.repaired +=
      result.stage == Stage::kRepaired || result.stage == Stage::kBlended || result.stage == Stage::kFailed;
}

// --- position impulse ---

// The gaps of the active contacts at the end of the step with the velocity v_; returns how far the law of the gaps is
// from being met: a loaded contact is open, or any contact overlaps [m].
double DenseStep::place_end(double h) {
  integrate(scene_->tree, q0_, v_, h, q1_);
  guards_->place(q1_);
  double error = 0.0;
  for (std::size_t k = 0; k < active_.size(); ++k) {
    DenseContact& c = contacts_[active_[k]];
    const BlockContact& block = problem_.contacts[k];
    evaluate(c.law, nullptr, c.at1);
    const double gap = c.at1.gap, n = lambda_[block.row];
    const double least = block.rows == 3 ? lambda_.segment<2>(block.row + 1).norm() / c.mu : 0.0;
    const double noise = guards_->is_noisy(c.point.guard) ? guards_->root_tolerance(c.point.guard) : kGapSolved;
    // What the normal impulse above its bound moves the contact by in the step: a gap that is open counts up to that.
    const double lift = std::max(0.0, n - least) * mobility_[k] * h;
    const double off = std::max(-gap, std::min(gap, lift));
    if (off > noise) error = std::max(error, off);
  }
  return error;
}

// W_n M^-1 W_n^T of the active contacts.
void DenseStep::set_mobilities() {
  for (std::size_t k = 0; k < active_.size(); ++k) {
    const BlockContact& c = problem_.contacts[k];
    double sum = 0.0;
    const double* w = problem_.W.data() + c.column;
    for (int block : {c.a, c.b}) {
      if (block < 0) continue;
      const int n = problem_.size(block), first = problem_.start[block];
      const Eigen::Map<const VecX> row(w, n);
      sum += row.dot(columns_.block(first, 0, n, n) * row);
      w = problem_.W.data() + c.column + c.rows * n;
    }
    mobility_[k] = sum;
  }
}

// The impulses have been changed and v_ with them: the smooth equation again, then the normal impulses for the gaps
// that it leads to, until the gaps of loaded contacts are zero and none overlaps.
bool DenseStep::gap_iterations(double h) {
  double last = INFINITY;
  for (int k = 0;; ++k) {
    p_start_ = p0_;
    add_impulses(problem_, lambda_, p_start_);
    if (!iterate_stage()) return false;
    const double error = place_end(h);
    if (error == 0.0 || k >= kGapIterations || (k > 3 && error > 0.9 * last)) return true;
    last = error;
    // v = v_free + M^-1 W lambda holds for the present v and lambda.
    problem_.v_free = v_;
    p_start_.setZero();
    add_impulses(problem_, lambda_, p_start_);
    for (int b = 0; b < problem_.blocks(); ++b) {
      const int n = problem_.size(b), first = problem_.start[b];
      problem_.v_free.segment(first, n) -= columns_.block(first, 0, n, n) * p_start_.segment(first, n);
    }
    for (std::size_t i = 0; i < active_.size(); ++i) {
      const BlockContact& block = problem_.contacts[i];
      problem_.offset[block.row] = contacts_[active_[i]].at1.gap / h - row_velocity(problem_, block, 0, v_);
    }
    p_start_ = v_;
    solver_.solve_normals(problem_, 1e-12, lambda_, v_);
    p_start_ = v_ - p_start_;
    integrator_.add_velocity(p_start_);
  }
}

bool DenseStep::position_problem() {
  active_.clear();
  for (int i = 0; i < static_cast<int>(contacts_.size()); ++i) active_.push_back(i);
  // Gaps at the end of the present motion, about which they are linearised.
  integrator_.stage_velocity(v_);
  guards_->place(q0_);
  set_rows(false);
  mobility_.assign(active_.size(), 0.0);
  place_end(h_);
  for (std::size_t i = 0; i < active_.size(); ++i) {
    const DenseContact& c = contacts_[active_[i]];
    const BlockContact& block = problem_.contacts[i];
    problem_.offset[block.row] = c.at1.gap / h_ - row_velocity(problem_, block, 0, v_);
    lambda_[block.row] = c.position[0];
    if (block.rows == 3) lambda_.segment<2>(block.row + 1) = c.position.tail<2>();
  }
  lambda_.tail(joint_friction_.size()) = joint_friction_;
  problem_.v_free = v_free_;
  set_mobilities();
  solver_.prepare(problem_);
  p_start_ = v_;
  // The energy is bounded at the end of the step, where the speeds of closed contacts are those of the law.
  const BlockResult result = solver_.solve(problem_, INFINITY, solver_options(), lambda_, v_);
  account(result);
  solver_error_ = std::min(result.residual, solver_options().accept) * result.scale;
  if (!v_.allFinite()) {
    why_ = "a number is not finite";
    return false;
  }
  p_start_ = v_ - p_start_;
  integrator_.add_velocity(p_start_);
  if (!gap_iterations(h_)) return false;
  for (std::size_t i = 0; i < active_.size(); ++i) {
    DenseContact& c = contacts_[active_[i]];
    const BlockContact& block = problem_.contacts[i];
    c.position.setZero();
    c.position.head(block.rows) = lambda_.segment(block.row, block.rows);
  }
  joint_friction_ = lambda_.tail(joint_friction_.size());
  return true;
}

// Points of near pairs that overlap at the end and are no candidates join them. True if there were any. The guards are
// placed at the end of the step.
bool DenseStep::add_violated() {
  points_.clear();
  laws_.clear();
  report_.gap = 0.0;
  bool limit_overlaps = false;
  guards_->place(q1_);
  for (Near& near : near_) {
    Contact witness;
    near.gap1 = guards_->evaluate_witness(near.guard, witness);
    const double noise = guards_->is_noisy(near.guard) ? 2.0 * guards_->root_tolerance(near.guard) : kGapPromised;
    if (near.gap1 < report_.gap) {
      report_.gap = near.gap1;
      report_.gap_noise = 2.0 * noise;
    }
    if (!scene_->is_pair(near.guard)) limit_overlaps |= near.gap1 < -kGapSolved;
    if (!(near.gap1 < -noise) || !scene_->is_pair(near.guard)) continue;
    const std::size_t count = points_.size();
    guards_->manifolds().find(near.guard, guards_->placements(), witness, 0.0, points_);
    for (std::size_t k = count; k < points_.size(); ++k) laws_.push_back(frozen(points_[k], witness));
  }
  // Limits, and points of pairs that became near since the problem was made, are among the contacts already.
  bool added = (limit_overlaps || !points_.empty()) && contacts_.size() > active_.size();
  guards_->place(q0_);
  for (std::size_t k = 0; k < points_.size(); ++k) {
    const int guard = points_[k].guard;
    const auto near = std::find_if(near_.begin(), near_.end(), [&](const Near& n) { return n.guard == guard; });
    added |= add_point(points_[k], laws_[k], near->witness0);
  }
  return added;
}

// --- velocity impulse ---

bool DenseStep::velocity_problem(double bound_energy) {
  integrator_.place_node(q1_);
  guards_->place(q1_);
  active_.clear();
  for (int i = 0; i < static_cast<int>(contacts_.size()); ++i) {
    DenseContact& c = contacts_[i];
    const double noise = guards_->is_noisy(c.point.guard) ? guards_->root_tolerance(c.point.guard) : kTouching;
    c.closed = c.position[0] > 0.0 || c.at1.gap <= noise;
    c.t1_1 = scene_->is_pair(c.point.guard) ? carried_tangent(c.t1_0, c.at0.normal, c.at1.normal) : Vec3(Vec3::Zero());
    if (c.closed) active_.push_back(i);
  }
  v1_ = p1_;
  integrator_.solve_mass(v1_);
  if (!v1_.allFinite()) {
    why_ = "a number is not finite";
    return false;
  }
  make_node_blocks();
  set_rows(true);
  for (std::size_t i = 0; i < active_.size(); ++i) {
    const DenseContact& c = contacts_[active_[i]];
    const BlockContact& block = problem_.contacts[i];
    lambda_.segment(block.row, block.rows) = c.velocity.head(block.rows);
  }
  lambda_.tail(joint_friction_.size()) = joint_friction_;
  problem_.v_free = v1_;
  solver_.prepare(problem_);
  account(solver_.solve(problem_, bound_energy, solver_options(), lambda_, v1_));
  add_impulses(problem_, lambda_, p1_);
  lambda_v_ = lambda_;
  return v1_.allFinite();
}

// Poisson's restitution: the contacts that closed fast expand with an impulse of at least e times what compressed them.
void DenseStep::restitution_problem(double bound_energy) {
  const double g = scene_->tree.gravity.norm();
  bool any = false;
  lambda_.setZero();
  for (std::size_t i = 0; i < active_.size(); ++i) {
    DenseContact& c = contacts_[active_[i]];
    BlockContact& block = problem_.contacts[i];
    const double compression = c.position[0] + lambda_v_[block.row];
    c.expands = c.restitution > 0.0 && c.closing < -kFastFall * g * h_ && compression > 0.0;
    if (!c.expands) continue;
    block.lower = c.restitution * compression;
    any = true;
  }
  if (!any) return;
  // The friction of joints in the expansion is what their bound has left.
  for (std::size_t i = active_.size(); i < problem_.contacts.size(); ++i) {
    BlockContact& joint = problem_.contacts[i];
    joint.box = std::max(kLeastDivisor, joint.box - std::abs(lambda_v_[joint.row]));
  }
  problem_.v_free = v1_;
  const VecX plastic = v1_;
  const BlockResult result = solver_.solve(problem_, INFINITY, solver_options(), lambda_, v1_);
  account(result);
  // Energy, cone and gaps are convex conditions: a share of the expansion keeps them as the whole and none of it do.
  const double share = expansion_share(plastic, bound_energy);
  if (share < 1.0) {
    lambda_ *= share;
    v1_ = plastic + share * (v1_ - plastic);
    ++report_.repaired;
  }
  add_impulses(problem_, lambda_, p1_);
  lambda_v_ += lambda_;
}

// The largest share of the step from `plastic` to v1_ with which the kinetic energy stays within the bound.
double DenseStep::expansion_share(const VecX& plastic, double bound_energy) const {
  double start = 0.0, slope = 0.0, square = 0.0;
  for (int b = 0; b < problem_.blocks(); ++b) {
    const int n = problem_.size(b), first = problem_.start[b];
    const VecX v = plastic.segment(first, n), d = v1_.segment(first, n) - v, Md = problem_.M[b] * d;
    start += 0.5 * v.dot(problem_.M[b] * v);
    slope += v.dot(Md);
    square += 0.5 * d.dot(Md);
  }
  const double room = bound_energy - start;
  if (start + slope + square <= bound_energy || !(square > 0.0)) return 1.0;
  if (room <= 0.0)
    return std::clamp(-slope / square, 0.0, 1.0) > 0.0 && slope < 0.0 ? std::min(1.0, -slope / square) : 0.0;
  const double root = std::sqrt(slope * slope + 4.0 * square * room);
  return std::clamp(slope > 0.0 ? 2.0 * room / (slope + root) : (root - slope) / (2.0 * square), 0.0, 1.0);
}

// Error of a step without impacts inside of it: the energy that it conserves differs from H by terms of the order h^2,
// which change with the acceleration. The factor is that of the modified Hamiltonian, h^2 a M a/24 + ..., with room for
// its other terms.
double DenseStep::smooth_contact_error() const {
  const double fast = kFastFall * scene_->tree.gravity.norm() * h_;
  for (const DenseContact& c : contacts_)
    if (c.position[0] > 0.0 && c.closing < -fast) return 0.0;
  if (memory_.change.size() != v_.size()) return 0.0;
  double error = 0.0;
  for (int b = 0; b < problem_.blocks(); ++b) {
    const int n = problem_.size(b), first = problem_.start[b];
    const VecX d = 2.0 * (v_ - v0_).segment(first, n);
    error += std::abs(d.dot(problem_.M[b] * (d - memory_.change.segment(first, n) * (h_ / memory_.h))));
  }
  return 0.5 * error;
}

// Largest angular speed of a joint in the step [rad/s].
double DenseStep::fastest_turn() const {
  double fastest = 0.0;
  for (const Joint& joint : scene_->tree.joints) {
    const bool slides = joint.type == JointType::kPrismatic || joint.type == JointType::kTranslation;
    if (!slides) fastest = std::max(fastest, v_.segment(joint.iv, joint.nv).norm());
  }
  return fastest;
}

// --- the step ---

bool DenseStep::solve(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) {
  why_ = "";
  report_ = DenseReport();
  if (!solve_smooth(q0, p0, h, tau)) return false;
  const Energy before = energy(integrator_, q0, p0);
  integrator_.finish(q1_, p1_);
  const Energy free = energy(integrator_, q1_, p1_);
  const double rounding = kEnergyRounding * (potential_scale(before) + potential_scale(free));
  report_.energy_error =
      rounding + std::abs(free.kinetic + free.potential - before.kinetic - before.potential - integrator_.work());
  make_step_blocks();
  w_ = 2.0 * v_free_ - v0_;
  bound_.setZero();
  add_size(scene_->tree, v0_, 1.0, bound_);
  v1_ = bound_;
  bound_.setZero();
  add_size(scene_->tree, w_, 1.0, bound_);
  bound_ = bound_.cwiseMax(v1_);
  contacts_.clear();
  near_.clear();
  joint_friction_ = h * memory_.joint_friction;
  collect(q0);
  for (int k = 0; k < kAdditions; ++k) {
    if (!position_problem()) return false;
    // Impulses may have made a body faster than the bound with which the candidates were found.
    w_.setZero();
    add_size(scene_->tree, v_, 1.0, w_);
    if ((w_ - bound_).maxCoeff() > 0.0) {
      bound_ = bound_.cwiseMax(kWider * w_);
      collect(q0);
    }
    if (!add_violated()) break;
  }
  // Points that joined after the last solution have no impulse: they do not overlap, or the step is refused.
  contacts_.resize(active_.size());
  for (DenseContact& c : contacts_) c.closing = 0.0;
  guards_->place(q0_);
  for (std::size_t i = 0; i < active_.size(); ++i)
    contacts_[active_[i]].closing = row_velocity(problem_, problem_.contacts[i], 0, v0_);
  p_start_ = p0_;
  add_impulses(problem_, lambda_, p_start_);
  joint_friction_loss_ = 0.0;
  for (std::size_t i = active_.size(); i < problem_.contacts.size(); ++i)
    joint_friction_loss_ -= lambda_[problem_.contacts[i].row] * row_velocity(problem_, problem_.contacts[i], 0, v_);
  integrator_.set_start_momentum(p_start_);
  integrator_.finish(q1_, p1_);
  const Energy middle = energy(integrator_, q1_, p1_);
  // Speeds of contacts that are wrong by the residual that the solver accepts change the energy by impulse times speed.
  double impulses = 0.0;
  for (const DenseContact& c : contacts_) impulses += c.position.norm();
  report_.energy_error += impulses * solver_error_ + smooth_contact_error() + kEnergyShare * before.kinetic;
  const double turn = h * fastest_turn();
  report_.energy_error +=
      turn * turn / 12.0 * (std::abs(middle.potential - before.potential) + std::abs(free.kinetic - before.kinetic));
  const double allowed =
      before.kinetic + before.potential + integrator_.work() + report_.energy_error - middle.potential;
  if (!velocity_problem(allowed)) {
    why_ = "a number is not finite";
    return false;
  }
  restitution_problem(allowed);
  for (std::size_t i = active_.size(); i < problem_.contacts.size(); ++i)
    joint_friction_loss_ -= lambda_v_[problem_.contacts[i].row] * row_velocity(problem_, problem_.contacts[i], 0, v1_);
  for (DenseContact& c : contacts_) {
    c.velocity.setZero();
    c.slip_W.setZero();
    c.slip_speed = 0.0;
  }
  for (std::size_t i = 0; i < active_.size(); ++i) {
    DenseContact& c = contacts_[active_[i]];
    const BlockContact& block = problem_.contacts[i];
    c.velocity.head(block.rows) = lambda_v_.segment(block.row, block.rows);
    if (block.rows == 3) {
      const Vec3 t2 = c.at1.normal.cross(c.t1_1);
      c.slip_W = row_velocity(problem_, block, 1, v1_) * c.t1_1 + row_velocity(problem_, block, 2, v1_) * t2;
      c.slip_speed = c.slip_W.norm();
    }
    report_.contacts += c.position[0] + c.velocity[0] > 0.0;
  }
  const double after = 0.5 * p1_.dot(v1_) + middle.potential;
  const double change = after - before.kinetic - before.potential - work();
  report_.energy_rise = std::max(0.0, change - report_.energy_error);
  report_.energy_loss = -change;
  if (!q1_.allFinite() || !p1_.allFinite()) {
    why_ = "a number is not finite";
    return false;
  }
  return true;
}

bool DenseStep::keeps_promises() const { return report_.gap >= -report_.gap_noise && report_.energy_rise <= 0.0; }

void DenseStep::finish(VecRef q1, VecRef p1) const {
  q1 = q1_;
  p1 = p1_;
}

void DenseStep::commit() {
  memory_.joint_friction = joint_friction_ / h_;
  memory_.closed.clear();
  memory_.change = v1_ - v0_;
  memory_.h = h_;
  memory_.impulses.clear();
  for (const DenseContact& c : contacts_) {
    if (c.closed) memory_.closed.push_back(c.point.guard);
    if (!(c.position[0] + c.velocity[0] > 0.0)) continue;
    // An expansion does not go on.
    const Vec3 velocity = c.expands ? c.position_W() : c.velocity_W();
    if (scene_->is_pair(c.point.guard))
      memory_.impulses.push_back({c.point.guard, c.point.feature, c.position_W() / h_, velocity / h_});
    else
      memory_.impulses.push_back({c.point.guard, 0, Vec3(c.position[0] / h_, 0, 0), Vec3(c.velocity[0] / h_, 0, 0)});
  }
}

}  // namespace contactvi

// StepEquations: the end of a step, what is asked of it, and the mass matrix at its nodes.
#include "step/step_equations.hpp"

#include <algorithm>
#include <cmath>

#include "model/coupling.hpp"
#include "step/ball_step.hpp"
#include "step/node_lanes.hpp"

namespace contactvi {

namespace {

// Whether every joint has as many numbers in q as in v: none is a quaternion or (cos, sin), and sums make its end.
bool is_plain(const Tree& tree) { return tree.nq == tree.nv; }

// to = base + step, and what that sum loses of the step.
inline void add_carried(double base, double step, double& to, double& lost) {
  const double total = base + step;
  lost = step - (total - base);
  to = total;
}

// to = base + weight rate + carried carry of n numbers.
void add_weighted(int n, const double* base, double weight, const double* rate, double carried, const double* carry,
                  double* __restrict to, double* __restrict lost) {
  for (int d = 0; d < n; ++d) {  // as add_carried, for several at a time
    const double step = weight * rate[d] + carried * carry[d], total = base[d] + step;
    lost[d] = step - (total - base[d]);
    to[d] = total;
  }
}

// The momenta at the end of a step, of all dofs as if none were of a spherical joint.
void add_impulses(const Stages& stages, const VecX& p0, const VecX& carry, double carried, double* p1, double* lost) {
  const double* G = stages.G();
  if (stages.padded() == 1) {  // one number per dof: no sums
    add_weighted(static_cast<int>(p0.size()), p0.data(), stages.hb()[0], G, carried, carry.data(), p1, lost);
    return;
  }
  for (int d = 0; d < static_cast<int>(p0.size()); ++d)
    add_carried(p0[d], stages.sum(G, d) + carried * carry[d], p1[d], lost[d]);
}

}  // namespace

StepEquations::StepEquations(const Tree& tree, int stages)
    : tree_(&tree),
      model_(tree),
      stages_(tree, model_, stages),
      node_(tree, model_, 1),
      stiff_(tree, stages_),
      columns_(tree, model_),
      q0_(tree.nq),
      p0_(tree.nv),
      carry_q_(VecX::Zero(tree.nq)),
      carry_p_(VecX::Zero(tree.nv)),
      next_carry_q_(VecX::Zero(tree.nq)),
      next_carry_p_(VecX::Zero(tree.nv)),
      placements_(tree),
      q_stage_(tree.nq),
      rates_(tree.nv, stages),
      velocities_(tree.nv, stages) {}

void StepEquations::begin(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau, double after) {
  if (q0.data() != q0_.data()) std::copy_n(q0.data(), tree_->nq, q0_.data());
  if (p0.data() != p0_.data()) std::copy_n(p0.data(), tree_->nv, p0_.data());
  h_ = h;
  stages_.set_time(time_ + after);
  stages_.begin(q0_, p0_, h, tau);
}

void StepEquations::start_constant(const VecCRef& v0) {
  const int S = stages_.padded();
  for (int d = 0; d < tree_->nv; ++d) std::fill_n(stages_.v() + static_cast<std::size_t>(d) * S, S, v0[d]);
}

void StepEquations::clear_turns() {
  if (model_.lanes.balls == 0) return;
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical) continue;
    double* X = stages_.X() + static_cast<std::size_t>(joint.iv) * stages_.padded();
    std::fill(X, X + 3 * stages_.padded(), 0.0);
  }
}

void StepEquations::iterate_stages(int flags) {
  const bool factor = (flags & kLaneFactor) != 0;
  stages_.iterate(flags);
  if (stiff_.any()) {
    const std::vector<CompliantContact>& contacts = tree_->elements.compliances;
    const auto rubs = [](const CompliantContact& c) { return c.law.rubs(); };
    if (std::none_of(contacts.begin(), contacts.end(), rubs)) {
      if (factor) stiff_.factor(stages_, q0_);
    } else {
      // Friction of compliant contacts changes within their slip speed, which is little beside a correction without it:
      // its derivatives are those of the velocities before that, in each iteration anew.
      const std::size_t count = static_cast<std::size_t>(tree_->nv) * static_cast<std::size_t>(stages_.padded());
      const std::vector<double> corrected(stages_.v(), stages_.v() + count);
      for (std::size_t k = 0; k < count; ++k) stages_.v()[k] -= stages_.dv()[k];
      stiff_.factor(stages_, q0_);
      std::copy(corrected.begin(), corrected.end(), stages_.v());
    }
    stiff_.correct(stages_);
  }
  count_iteration(flags);
}

void StepEquations::count_iteration(int flags) {
  ++counters.stage_iterations;
  counters.factorizations += (flags & kLaneFactor) != 0;
}

// Followers end where their leaders put them, and what has acted on them has acted on their leaders.
void StepEquations::finish(VecRef q1, VecRef p1) {
  finish_all(q1, p1);
  if (tree_->followers.empty()) return;
  fold_momentum(*tree_, p1);
  fold_momentum(*tree_, next_carry_p_);
  follow_configuration(*tree_, q1);
  for (const Follower& f : tree_->followers) next_carry_q_[f.iq] = 0.0;
}

// As if no joints were coupled.
void StepEquations::finish_all(VecRef q1, VecRef p1) {
  if (model_.lanes.balls > 0) stages_.rates();
  const double carried = part_ ? 0.0 : 1.0;  // the digits carried are those of the next whole step
  add_impulses(stages_, *momentum_, carry_p_, carried, p1.data(), next_carry_p_.data());
  const double* v = stages_.v();
  const bool single = stages_.padded() == 1;
  const double weight = stages_.hb()[0];
  if (single && is_plain(*tree_)) {
    add_weighted(tree_->nq, q0_.data(), weight, v, carried, carry_q_.data(), q1.data(), next_carry_q_.data());
    return;
  }
  for (const Joint& joint : tree_->joints) {
    const int iq = joint.iq, iv = joint.iv;
    if (joint.type == JointType::kSpherical) {
      const Vec3 X1(stages_.sum(stages_.rate(), iv), stages_.sum(stages_.rate(), iv + 1),
                    stages_.sum(stages_.rate(), iv + 2));
      const Quat start(q0_[iq + 3], q0_[iq], q0_[iq + 1], q0_[iq + 2]);
      const Vec3 end = stages_.ball_end(joint, *momentum_);
      q1.segment<4>(iq) = end_ball(start, X1).coeffs();
      p1.segment<3>(iv) = end;
      next_carry_p_.segment<3>(iv).setZero();
      continue;
    }
    if (joint.type == JointType::kContinuous) {
      const double angle = stages_.sum(v, iv), c = std::cos(angle), s = std::sin(angle);
      const double c1 = q0_[iq] * c - q0_[iq + 1] * s, s1 = q0_[iq] * s + q0_[iq + 1] * c;
      const double scale = 1 / std::sqrt(c1 * c1 + s1 * s1);
      q1[iq] = scale * c1;
      q1[iq + 1] = scale * s1;
      continue;
    }
    for (int d = 0; d < joint.nv; ++d) {
      const double change = single ? weight * v[iv + d] : stages_.sum(v, iv + d);
      add_carried(q0_[iq + d], change + carried * carry_q_[iq + d], q1[iq + d], next_carry_q_[iq + d]);
    }
  }
}

const MatX& StepEquations::rates() {
  if (model_.lanes.balls > 0) stages_.rates();
  for (int i = 0; i < stages_.count(); ++i)
    for (int d = 0; d < tree_->nv; ++d) rates_(d, i) = stages_.rate()[d * stages_.padded() + i];
  return rates_;
}

const MatX& StepEquations::velocities() {
  for (int i = 0; i < stages_.count(); ++i)
    for (int d = 0; d < tree_->nv; ++d) velocities_(d, i) = stages_.v()[d * stages_.padded() + i];
  return velocities_;
}

void StepEquations::stage_state(int i, VecRef q, VecRef v) {
  stages_.configuration(q0_, i, q);
  for (int d = 0; d < tree_->nv; ++d) v[d] = stages_.v()[d * stages_.padded() + i];
}

// Of the numbers v of the stages, as Stages keeps them.
double StepEquations::highest_mode(const double* v) const {
  constexpr int kSideBySide = 4;  // dofs, whose sums do not wait for each other
  const int s = stages_.count(), S = stages_.padded(), nv = tree_->nv;
  const double* weight = stages_.table().to_legendre[s - 1];
  double sum = 0.0;
  for (int first = 0; first < nv; first += kSideBySide) {
    const int count = std::min(kSideBySide, nv - first);
    double mode[kSideBySide] = {};
    const double* row[kSideBySide];
    for (int k = 0; k < kSideBySide; ++k) row[k] = v + (first + std::min(k, count - 1)) * S;
    for (int j = 0; j < s; ++j)
      for (int k = 0; k < kSideBySide; ++k) mode[k] += weight[j] * row[k][j];
    for (int k = 0; k < count; ++k) sum += mode[k] * mode[k];
  }
  return std::abs(h_) * std::sqrt(sum);
}

double StepEquations::stage_motion() const {
  const int s = stages_.count(), S = stages_.padded();
  double largest = 0.0;
  for (int j = 0; j < s; ++j) {
    double sum = 0.0;
    for (int d = 0; d < tree_->nv; ++d) sum += stages_.v()[d * S + j] * stages_.v()[d * S + j];
    largest = std::max(largest, sum);
  }
  return std::abs(h_) * std::sqrt(largest);
}

// Gauss quadrature over the step of value(i), given at the stages.
template <class Value>
double StepEquations::quadrature(Value value) const {
  double total = 0.0;
  for (int i = 0; i < stages_.count(); ++i) total += h_ * stages_.table().b[i] * value(i);
  return total;
}

double StepEquations::input_work() const {
  return quadrature([&](int i) { return stages_.input_power(i); });
}

double StepEquations::damping_loss() const {
  return quadrature([&](int i) { return stages_.dissipation(i); });
}

double StepEquations::mean_work() const {
  const GaussTable& table = stages_.table();
  double total = 0.0;
  for (int j = 0; j < stages_.count(); ++j) {
    double weight = 0.0;
    for (int i = 0; i < stages_.count(); ++i) weight += table.b[i] * table.A[i][j];
    total += h_ * weight * (stages_.input_power(j) - stages_.dissipation(j));
  }
  return total;
}

VecX StepEquations::coupled_impulses() const {
  VecX found(static_cast<Eigen::Index>(tree_->followers.size()));
  for (Eigen::Index k = 0; k < found.size(); ++k) {
    const int dof = tree_->followers[k].iv;
    found[k] = (*momentum_)[dof] + quadrature([&](int i) { return stages_.G()[dof * stages_.padded() + i]; });
  }
  return found;
}

double StepEquations::discrete_energy() {
  const int S = stages_.padded();
  double total = 0.0;
  for (int i = 0; i < stages_.count(); ++i) {
    stages_.configuration(q0_, i, q_stage_);
    place(*tree_, q_stage_, placements_);
    double energy = total_potential(*tree_, stages_.field(), placements_, q_stage_);
    // P belongs to the velocity before the last correction: 1/2 (v - dv) M (v - dv) + ... = 1/2 P.(v + dv) to second
    // order.
    for (int d = 0; d < tree_->nv; ++d)
      energy += 0.5 * stages_.P()[d * S + i] * (stages_.v()[d * S + i] + stages_.dv()[d * S + i]);
    total += stages_.table().b[i] * energy;
  }
  return total;
}

bool StepEquations::node_velocity(const VecCRef& q, const VecCRef& p, VecRef v) {
  node_.at(q);
  node_.place();
  node_.factor();
  for (int d = 0; d < tree_->nv; ++d) node_.dv()[d] = p[d];
  node_.solve();
  return get_velocity(node_, p, v);
}

void StepEquations::place_node(const VecCRef& q) {
  node_.at(q);
  node_.place();
  node_.factor();
}

void StepEquations::solve_mass(VecRef x) {
  for (int d = 0; d < tree_->nv; ++d) node_.dv()[d] = x[d];
  node_.solve();
  for (int d = 0; d < tree_->nv; ++d) x[d] = node_.dv()[d];
}

void StepEquations::dynamics(const VecCRef& q, const VecCRef& v, VecRef P, VecRef G) {
  node_.at(q);
  for (int d = 0; d < tree_->nv; ++d) node_.v()[d] = v[d];
  node_.evaluate();
  for (int d = 0; d < tree_->nv; ++d) {
    P[d] = node_.P()[d];
    G[d] = node_.G()[d];
  }
  if (tree_->lent_armature.size() > 0) P -= tree_->lent_armature.cwiseProduct(v);
}

bool StepEquations::complete_momentum(const VecCRef& q, VecRef p) {
  if (tree_->followers.empty()) return true;
  VecX v(tree_->nv), G(tree_->nv);
  if (!node_velocity(q, p, v)) return false;
  dynamics(q, v, p, G);
  return true;
}

}  // namespace contactvi

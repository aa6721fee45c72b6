#include "sensitivity/dense_step_tangent.hpp"

#include <algorithm>
#include <cmath>

#include "base/tolerances.hpp"
#include "step/energy.hpp"
#include "step/path.hpp"

namespace contactvi {

namespace {
constexpr double kLaw = 1e-7;  // of the impulses and speeds: ten times what the solver leaves where it is at its end

}  // namespace

DenseStepTangent::DenseStepTangent(const Scene& scene, bool take_branch)
    : scene_(&scene),
      take_branch_(take_branch),
      start_masses_(scene.tree, 1, 1e-12, 1),
      masses_(scene.tree, 1, 1e-12, 1),
      step_masses_(scene),
      free_(scene.tree, 1),
      twists_(scene.tree),
      v0_(scene.tree.nv),
      q_stage_(scene.tree.nq),
      none_(VecX::Zero(scene.tree.nv)),
      dv0_(scene.tree.nv),
      dp_(scene.tree.nv),
      work_(scene.tree.nv) {}

void DenseStepTangent::refuse(const char* reason, int guard, const std::string& fact, const char* expected,
                              const std::string& got, const char* remedy) const {
  throw NoDerivative({reason, guard, record_->t}, fact, expected, got, remedy);
}

void DenseStepTangent::note(const DenseLaws& laws) {
  margin_ = std::min(margin_, laws.margin());
  error_ = std::max(error_, laws.error());
}

void DenseStepTangent::take(const DenseStepRecord& step, const VecX& tau, const Servo* servo) {
  record_ = &step;
  margin_ = 1.0;
  error_ = 0.0;
  approximate_ = "";
  rows_ = static_cast<int>(step.lambda.size());
  has_friction_ = !step.joints.empty();
  for (const DenseStepRecord::Contact& c : step.contacts) has_friction_ |= c.mu > 0.0;
  take_geometry();
  take_masses(tau, servo);
  free_.take(step.q0, step.p0, step.h, tau, step.t, servo, step.places[0].v);
  while (rounds_.size() < step.rounds.size()) rounds_.emplace_back(scene_->tree);
  set_scale();
  for (std::size_t k = 0; k < step.rounds.size(); ++k) take_round(k, tau, servo);
  take_end();
  if (step.repaired > 0) approximate("an answer that was repaired or blended");
  if (step.keeps_energy) approximate("gaps that are left for the sake of the energy");
  if (error_ > kLaw) approximate("impulses that do not satisfy the law of contact");
  if (margin_ < kOnCone) approximate("a contact between two of open, sticking and slipping");
}

// The largest impulse of the step, and the largest speed at its start, without impulses or to close its gaps.
void DenseStepTangent::set_scale() {
  const DenseStepRecord& s = *record_;
  const DenseStepRecord::Place& free = s.places[0];
  scale_ = {};
  if (rows_ == 0) return;
  scale_.impulse = std::max(s.lambda.lpNorm<Eigen::Infinity>(), s.plastic.lpNorm<Eigen::Infinity>());
  scale_.speed = std::max((s.W0.transpose() * v0_).lpNorm<Eigen::Infinity>(),
                          (s.W0.transpose() * free.v).lpNorm<Eigen::Infinity>());
  for (std::size_t i = 0; i < s.contacts.size(); ++i)
    scale_.speed = std::max(scale_.speed, std::abs(free.end[i].gap - s.contacts[i].allowed) / s.h);
}

// The geometry of the contacts at the start, at the places with which slips are made, and at the end.
void DenseStepTangent::take_geometry() {
  const DenseStepRecord& s = *record_;
  const std::size_t n = s.contacts.size();
  const auto take = [&](std::vector<ContactTangent>& tangents, const VecX& q, const auto& contact_at) {
    while (tangents.size() < n) tangents.emplace_back(*scene_);
    for (std::size_t i = 0; i < n; ++i) {
      const DenseStepRecord::Contact& c = s.contacts[i];
      if (tangents[i].take(q, c.point.guard, contact_at(i), &c.law)) continue;
      refuse("witness", c.point.guard, "The gap of a contact has no second derivative", "one pair of nearest points",
             tangents[i].why(), "Start elsewhere, or round the edges of the shapes");
    }
  };
  take(start_, s.q0, [&](std::size_t i) { return s.contacts[i].start; });
  take(end_, s.places.back().q, [&](std::size_t i) { return s.contacts[i].end; });
  if (slip_.size() < s.places.size()) slip_.resize(s.places.size());
  std::vector<char> wanted(s.places.size(), 0);
  for (const DenseStepRecord::Round& round : s.rounds)
    for (char lasting : round.lasting) wanted[round.slips] |= lasting;
  for (std::size_t k = 0; k < wanted.size(); ++k)
    if (wanted[k] != 0) take(slip_[k], s.places[k].q, [&](std::size_t i) { return s.places[k].end[i]; });
  is_found_.assign(n, 0);
  clear_law_changes();
  while (found_.size() < n) found_.emplace_back(*scene_);
  for (std::size_t i = 0; i < n; ++i) {
    const DenseStepRecord::Contact& c = s.contacts[i];
    is_found_[i] = c.law.kind != c.point.kind;
    if (is_found_[i] == 0) continue;
    const bool at_start = c.found < 0;
    const VecX& q = at_start ? s.q0 : s.places[c.found].q;
    if (found_[i].take(q, c.point.guard, at_start ? c.start : s.places[c.found].end[i], &c.point)) continue;
    refuse("witness", c.point.guard, "The gap of a contact has no second derivative", "one pair of nearest points",
           found_[i].why(), "Start elsewhere, or round the edges of the shapes");
  }
  dn0_.assign(n, Vec3::Zero());
  dt1_.assign(n, Vec3::Zero());
  dW0_.setZero(scene_->tree.nv, rows_);
  dW1_.setZero(scene_->tree.nv, rows_);
}

void DenseStepTangent::take_masses(const VecX& tau, const Servo* servo) {
  const DenseStepRecord& s = *record_;
  if (!start_masses_.node_velocity(s.q0, s.p0, v0_)) throw Error("the mass matrix is not positive definite");
  q_stage_ = s.q0;
  integrate(scene_->tree, s.q0, v0_, 0.5 * s.h, q_stage_);
  D_.compute(s.D);
  DinvW_ = D_.solve(s.W0);
  if (!s.contacts.empty()) step_masses_.take(s, tau, servo, v0_);
}

void DenseStepTangent::take_round(std::size_t k, const VecX& tau, const Servo* servo) {
  const DenseStepRecord& s = *record_;
  const DenseStepRecord::Round& r = s.rounds[k];
  const DenseStepRecord::Place &about = s.places[r.about], &slips = s.places[r.slips], &next = s.places[k + 1];
  Round& round = rounds_[k];
  const int n = scene_->tree.nv;
  round.lambda = k + 1 == s.rounds.size() ? s.lambda : next.lambda;
  VecX w = s.W0.transpose() * r.v;
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const DenseStepRecord::Contact& c = s.contacts[i];
    if (r.present[i] == 0) {  // it had joined later: open
      w[c.row] = 1.0 + scale_.speed;
      continue;
    }
    w[c.row] += (about.end[i].gap - c.allowed) / s.h - s.W0.col(c.row).dot(about.v);
    if (r.lasting[i] == 0) continue;
    for (int t = c.row + 1; t < c.row + 3; ++t) w[t] += 0.5 * (slips.W.col(t) - s.W0.col(t)).dot(slips.v);
  }
  VecX box = VecX::Zero(rows_);
  for (std::size_t j = 0; j < s.joints.size(); ++j) box[static_cast<Eigen::Index>(j)] = 0.5 * s.h * s.joints[j].limit;
  round.law.take_law(s, r.lambda, w, s.W0.transpose() * DinvW_, VecX::Zero(rows_), box, scale_);
  if (has_friction_) note(round.law);
  if (!s.contacts.empty()) {
    round.mass_effect = step_masses_.effect(r.v - s.places[r.anew ? 0 : r.about].v);
  } else {
    round.mass_effect.setZero(n, 3 * n + 1);
  }
  round.step.take(s.q0, s.p0 + s.W0 * round.lambda, s.h, tau, s.t, servo, next.v);
  for (MatX* X : {&round.Q, &round.P, &round.V}) X->resize(n, rows_);
  StepDirection unit;
  VecX dq(n), dp(n), dv(n);
  for (int row = 0; row < rows_; ++row) {
    unit.p = s.W0.col(row);
    if (!round.step.solve(unit, dq, dp))
      refuse("step", -1, "The derivative of a step was not solved", "tangent equations with a solution", "none",
             "Use a smaller dt");
    round.step.velocity_change(0, dv);
    round.Q.col(row) = dq;
    round.P.col(row) = dp;
    round.V.col(row) = dv;
  }
  std::vector<double> gaps;
  for (std::size_t i = 0; i < s.contacts.size(); ++i) gaps.push_back(next.end[i].gap - s.contacts[i].allowed);
  round.gaps.take_gaps(s, round.lambda, gaps, next.W.transpose() * round.Q / s.h);
  check_round(round);
}

// What the laws leave open must have no effect. Where it has, the solver's way decides about the motion.
void DenseStepTangent::check_shared(const DenseLaws& laws, const MatX& effect) {
  const MatX& free = laws.free();
  if (free.cols() == 0 || !((effect * free).cwiseAbs().maxCoeff() > kShared * effect.cwiseAbs().maxCoeff())) return;
  approximate("points whose shares of a load decide about the motion");
  if (take_branch_) return;
  refuse("redundant", record_->contacts.empty() ? -1 : record_->contacts[0].point.guard,
         "The motion depends on how contact points share their load", "a motion that the laws of contact determine",
         "points that turn while they slip, or land together",
         "Use fewer points (contact_points=3), or on_kink='taken' for the derivative with impulses of least norm");
}

// Friction is found by the law and stays in the gap iterations, where it bounds normal impulses: how points share it
// may then have an effect.
void DenseStepTangent::check_round(const Round& round) {
  check_shared(round.gaps, round.P);
  check_shared(round.gaps, round.V);
  if (!has_friction_) return;
  check_shared(round.law, DinvW_);
  const MatX& free = round.law.free();
  for (Eigen::Index k = 0; k < free.cols(); ++k) {
    VecX known = free.col(k);
    low_changes(round, VecX(), known);
    const VecX effect = round.P * round.gaps.from_known(known);
    if (effect.cwiseAbs().maxCoeff() > kShared * round.P.cwiseAbs().maxCoeff())
      approximate("friction that several points share, on which the gaps depend");
  }
}

void DenseStepTangent::take_end() {
  const DenseStepRecord& s = *record_;
  masses_.place_node(s.places.back().q);
  MinvW_ = s.W1;
  for (const DenseStepRecord::Contact& c : s.contacts)
    if (!c.closed) MinvW_.middleCols(c.row, c.mu > 0.0 ? 3 : 1).setZero();
  masses_.solve_masses(MinvW_);
  G_.noalias() = s.W1.transpose() * MinvW_;
  const VecX none = VecX::Zero(rows_);
  plastic_.lambda = s.plastic;
  plastic_.v = s.v_plastic;
  VecX box = none, low = none;
  for (std::size_t j = 0; j < s.joints.size(); ++j) box[static_cast<Eigen::Index>(j)] = 0.5 * s.h * s.joints[j].limit;
  // A contact that takes no part is open: its speed is as large as can be.
  const auto speeds = [&](const VecX& v) {
    VecX w = s.W1.transpose() * v;
    for (const DenseStepRecord::Contact& c : s.contacts)
      if (!c.closed) w[c.row] = 1.0 + scale_.speed;
    return w;
  };
  plastic_.laws.take_law(s, s.plastic, speeds(s.v_plastic), G_, low, box, scale_);
  note(plastic_.laws);
  check_shared(plastic_.laws, MinvW_);
  if (s.expansion.size() == 0) return;
  for (const DenseStepRecord::Contact& c : s.contacts)
    if (c.expands) low[c.row] = c.restitution * (s.lambda[c.row] + s.plastic[c.row]);
  for (std::size_t j = 0; j < s.joints.size(); ++j) {
    const auto r = static_cast<Eigen::Index>(j);
    box[r] = std::max(kLeastDivisor, box[r] - std::abs(s.plastic[r]));
  }
  expansion_.lambda = s.plastic + s.expansion;
  expansion_.v = s.v_expansion;
  expansion_.laws.take_law(s, s.expansion, speeds(s.v_expansion), G_, low, box, scale_);
  note(expansion_.laws);
  check_shared(expansion_.laws, MinvW_);
  if (s.expanded < 1.0) take_energy();
}

// An expansion that was cut keeps the energy of the start.
void DenseStepTangent::take_energy() {
  const DenseStepRecord& s = *record_;
  approximate("restitution that was lowered to lose energy");
  energy_q0_.resize(scene_->tree.nv);
  energy_q1_.resize(scene_->tree.nv);
  energy_gradient(start_masses_, s.q0, v0_, energy_q0_);
  energy_gradient(start_masses_, s.places.back().q, s.v1, energy_q1_);
  expansion_rate_ = s.v1.dot(s.W1 * s.expansion);
}

}  // namespace contactvi

// DenseStep: what the surfaces of its contacts have besides Coulomb's law with one number: friction that depends on the
// slip or the force, restitution that depends on the speeds, surfaces that move along themselves, adhesion.
#include <algorithm>
#include <cmath>

#include "base/tolerances.hpp"
#include "contact/dense_step.hpp"
#include "model/restitution.hpp"

namespace contactvi {

namespace {
// Coefficients of friction that depend on the forces of a problem are found with them in so many rounds at most, to
// this of themselves, which is below the error of the law. Contacts may pass a load to and fro: after the first rounds
// they go half of the way.
constexpr double kFrictionNear = 1e-6;
constexpr int kFrictionRounds = 16, kWholeRounds = 2;
}  // namespace

// The adhesion of the present problem: of the points that touch at the start of the step, unless they separate faster
// than the pull could stop within it.
void DenseStep::set_pulls() {
  adheres_ = false;
  std::vector<DenseContact>& all = candidates_.contacts();
  for (DenseContact& c : all) {
    c.pull.setZero();
    c.pull_rate.setZero();
  }
  if (std::none_of(scene_->laws.begin(), scene_->laws.end(), [](const ContactLaw& law) { return law.adheres(); }))
    return;
  pull_.setZero(rows_.problem().rows());
  // Of a pair, or of a body (below zero): what it pulls with at a time, and the points that share it.
  const auto touches = [&](const DenseContact& c) {
    return c.at0.gap <= std::max(DenseCandidates::kGapPromised, candidates_.noise(c.point.guard));
  };
  const auto share = [&](const NumberFunction& pull, const auto& has) {
    std::vector<std::size_t> points;
    for (std::size_t i = 0; i < active_.size(); ++i)
      if (const ContactLaw* law = scene_->law(all[active_[i]].point.guard); law != nullptr && touches(all[active_[i]]))
        if (has(all[active_[i]].point.guard, *law)) points.push_back(i);
    if (points.empty()) return;
    for (int end = 0; end < 2; ++end) {
      const double t = t_ + end * h_, now = pull(t), weight = 0.5 * h_ / static_cast<double>(points.size());
      if (!(now > 0.0)) continue;
      const double rate = recorder_ ? pull.slope(t) : 0.0;
      for (const std::size_t i : points) {
        all[active_[i]].pull[end] += weight * now;
        all[active_[i]].pull_rate[end] += weight * rate;
      }
    }
  };
  for (std::size_t i = 0; i < active_.size(); ++i) {
    const int guard = all[active_[i]].point.guard;
    const ContactLaw* law = scene_->law(guard);
    const auto same = [&](int k) { return all[k].point.guard == guard; };
    if (law == nullptr || !law->pull.given() || std::any_of(active_.begin(), active_.begin() + i, same)) continue;
    share(law->pull, [guard](int other, const ContactLaw&) { return other == guard; });
  }
  for (int body = 0; body < static_cast<int>(scene_->body_pulls.size()); ++body)
    share(scene_->body_pulls[static_cast<std::size_t>(body)],
          [body](int, const ContactLaw& law) { return law.body_pulls[0] == body || law.body_pulls[1] == body; });
  for (std::size_t i = 0; i < active_.size(); ++i) {
    DenseContact& c = all[active_[i]];
    if (rows_.velocity(i, 0, v0_) > c.pull.sum() * mobility_[i]) {
      c.pull.setZero();
      c.pull_rate.setZero();
    }
    pull_[rows_.block(i).row] = c.pull[0];
    adheres_ |= c.pull.sum() > 0.0;
  }
}

// Friction that depends on the slip is that of its speed at the start of the step. All contacts are active.
void DenseStep::set_friction() {
  follows_forces_ = false;
  const auto varies = [this](int k) { return scene_->friction_varies(candidates_.contacts()[k].point.guard); };
  if (scene_->laws.empty() || std::none_of(active_.begin(), active_.end(), varies)) return;
  friction_states_.clear();
  for (std::size_t i = 0; i < active_.size(); ++i) {
    const DenseContact& c = candidates_.contacts()[active_[i]];
    const int guard = c.point.guard;
    friction_states_.push_back({guard, true, 0.0, 2.0 * c.position[0] / h_, t_, c.mu});
    if (c.rows() == 1 || !scene_->friction_varies(guard)) continue;
    const Eigen::Vector2d w(rows_.velocity(i, 1, v0_), rows_.velocity(i, 2, v0_));
    FrictionState& state = friction_states_.back();
    state.slip = c.frame(false).slip(w + c.drift0).norm();
    state.sticks = state.slip <= kStill * (1.0 + v0_.cwiseAbs().maxCoeff());
    follows_forces_ |= scene_->friction_by_state(guard);
  }
  contactvi::set_friction(*scene_, friction_states_);
  for (std::size_t i = 0; i < active_.size(); ++i)
    rows_.problem().contacts[i].mu = candidates_.contacts()[active_[i]].mu = friction_states_[i].mu;
}

// By how much of themselves coefficients of friction change with the impulses of the present problem, each of which
// acts for half of the step. An impact is a force that is the larger the shorter the step. speed: what the largest of
// the changes is worth [m/s]; half_way: they go half of the way.
double DenseStep::follow_forces(bool half_way, double& speed) {
  for (std::size_t i = 0; i < active_.size(); ++i)
    friction_states_[static_cast<std::size_t>(active_[i])].normal = 2.0 * lambda_[rows_.block(i).row] / h_;
  contactvi::set_friction(*scene_, friction_states_);
  double change = 0.0;
  speed = 0.0;
  for (std::size_t i = 0; i < active_.size(); ++i) {
    DenseContact& c = candidates_.contacts()[active_[i]];
    if (c.rows() == 1) continue;
    const double old = c.mu, normal = lambda_[rows_.block(i).row];
    change = FrictionRounds::larger(change, friction_states_[static_cast<std::size_t>(active_[i])].mu, c.mu);
    speed = std::max(speed, std::abs(c.mu - old) * normal * rows_.mobility(i));
    if (half_way) c.mu = std::sqrt(c.mu * old);
    rows_.problem().contacts[i].mu = c.mu;
  }
  return change;
}

// The law of the present problem again, with coefficients of friction that depend on its forces, until these stay.
void DenseStep::settle_friction(double bound_energy, VecX& v, BlockResult& result) {
  FrictionRounds rounds(kFrictionNear, kFrictionRounds);
  double speed = 0.0;
  for (int k = 0; rounds.go_on(follow_forces(k >= kWholeRounds, speed)); ++k) {
    result = solver_.solve(rows_.problem(), bound_energy, solver_options(), lambda_, v);
    note(result);
  }
  if (!rounds.settled()) result.residual = std::max(result.residual, speed / result.scale);
}

// The speed with which active contact i closes at the start of the step, and the restitution of one that closes fast.
void DenseStep::set_restitution(std::size_t i) {
  DenseContact& c = candidates_.contacts()[active_[i]];
  c.closing = rows_.velocity(i, 0, v0_);
  const ContactLaw* law = scene_->law(c.point.guard);
  if (!closes_fast(c) || law == nullptr || !restitution_varies(*law)) return;
  Vec3 slip = Vec3::Zero();
  if (c.rows() > 1)
    slip = c.frame(false).slip(Eigen::Vector2d(rows_.velocity(i, 1, v0_), rows_.velocity(i, 2, v0_)) + c.drift0);
  c.restitution = std::max(0.0, restitution_at(*law, -c.closing, slip.norm(), t_));
}

// What surfaces that move along themselves add to the tangential velocities of a contact, where the bodies are placed.
Eigen::Vector2d DenseStep::drift(const DenseContact& c, bool at_end) {
  if (scene_->surface_motions.empty() || !guards_->moves(c.point.guard)) return Eigen::Vector2d::Zero();
  return at_end ? guards_->surface_velocity(c.point.guard, c.at1, c.t1_1, t_ + h_)
                : guards_->surface_velocity(c.point.guard, c.at0, c.t1_0, t_);
}

// The same of its turning friction.
Vec3 DenseStep::turning_drift(const DenseContact& c, bool at_end) {
  Vec3 found = Vec3::Zero();
  if (!c.turns() || scene_->surface_motions.empty() || !guards_->moves(c.point.guard)) return found;
  VecX rates(scene_->law(c.point.guard)->turning_rows());
  guards_->surface_turning(c.point.guard, at_end ? c.at1 : c.at0, at_end ? c.t1_1 : c.t1_0, at_end ? t_ + h_ : t_,
                           rates);
  if (c.spinning > 0.0) found[0] = rates[0];
  if (c.rolling > 0.0) found.tail<2>() = rates.tail<2>();
  return found;
}

bool DenseStep::any_surface_moves() const {
  return !scene_->surface_motions.empty() &&
         std::any_of(contacts().begin(), contacts().end(),
                     [this](const DenseContact& c) { return guards_->moves(c.point.guard); });
}

// Adhesion acts to the end of the step also where a contact has opened within it: with half of it the energy would
// rise.
void DenseStep::pull_at_end() {
  const std::vector<DenseContact>& all = contacts();
  lasting_.clear();
  for (int i = 0; i < static_cast<int>(all.size()); ++i)
    if (all[i].pull[1] > 0.0) lasting_.push_back(i);
  end_rows_.set(all, lasting_, true, guards_->placements(), h_);
  VecX impulses = VecX::Zero(end_rows_.problem().rows());
  for (std::size_t k = 0; k < lasting_.size(); ++k) impulses[end_rows_.block(k).row] = -all[lasting_[k]].pull[1];
  end_rows_.add_impulses(impulses, p1_);
  v1_ = p1_;
  integrator_.solve_mass(v1_);
}

}  // namespace contactvi

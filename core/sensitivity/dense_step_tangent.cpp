#include "sensitivity/dense_step_tangent.hpp"

#include <algorithm>
#include <cmath>

#include "base/tolerances.hpp"
#include "model/restitution.hpp"
#include "sensitivity/kinks.hpp"
#include "sensitivity/known_laws.hpp"
#include "step/energy.hpp"
#include "step/path.hpp"

namespace contactvi {

namespace {
constexpr double kDenseLaw =
    1e-7;  // of the impulses and speeds: ten times what the solver leaves where it is at its end

}  // namespace

DenseStepTangent::DenseStepTangent(const Scene& scene, Kinks& kinks)
    : scene_(&scene),
      kinks_(&kinks),
      start_masses_(scene.tree, 1, 1e-12, 1),
      masses_(scene.tree, 1, 1e-12, 1),
      step_masses_(scene),
      free_(scene.tree, 1),
      start_constraints_(scene.tree),
      end_constraints_(scene.tree),
      twists_(scene.tree),
      guards_(scene),
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
  constraints_ = step.constraints;
  has_friction_ = !step.joints.empty();
  for (const DenseStepRecord::Contact& c : step.contacts) {
    has_friction_ |= c.mu > 0.0;
    refuse_friction_by_state(*scene_, c.point.guard, step.t);
    const ContactLaw* law = scene_->law(c.point.guard);
    if (law != nullptr && law->adheres() && !c.knows_pull)
      refuse("law", c.point.guard, "The file of the run does not keep the adhesion of its dense steps",
             "a run of this version", "one of an earlier version", "Make the run again");
    if (law == nullptr || law->turning_rows() == 0) continue;
    refuse("law", c.point.guard, "A dense step has a law of contact without a derivative there",
           "friction against slip alone, where events accumulate", "friction against spinning or rolling",
           "Use contact_mode='events', or spinning_radius=0, rolling_radius=0");
  }
  take_pulls();
  take_geometry();
  take_masses(tau, servo);
  take_coefficients();
  take_free(tau, servo);
  while (rounds_.size() < step.rounds.size()) rounds_.emplace_back(scene_->tree);
  set_scale();
  for (std::size_t k = 0; k < step.rounds.size(); ++k) take_round(k, tau, servo);
  take_end();
  if (step.repaired > 0) approximate("an answer that was repaired or blended");
  if (step.keeps_energy && !step.contacts.empty()) approximate("gaps that are left for the sake of the energy");
  if (error_ > kDenseLaw) approximate("impulses that do not satisfy the law of contact");
  if (margin_ < kOnCone) approximate("a contact between two of open, sticking and slipping");
}

void DenseStepTangent::take_pulls() {
  for (VecX* x : {&pull0_, &pull1_, &pull0_rate_, &pull1_rate_}) x->setZero(rows_);
  for (const DenseStepRecord::Contact& c : record_->contacts) {
    pull0_[c.row] = c.pull[0];
    pull1_[c.row] = c.pull[1];
    pull0_rate_[c.row] = c.pull_rate[0];
    pull1_rate_[c.row] = c.pull_rate[1];
  }
}

// Impulses of adhesion are half of it times the length of the step.
VecX DenseStepTangent::pull_change(bool at_end, const DenseStepDirection& d) const {
  return at_end ? VecX(d.h / record_->h * pull1_ + (d.t + d.h) * pull1_rate_)
                : VecX(d.h / record_->h * pull0_ + d.t * pull0_rate_);
}

// The largest impulse of the step, and the largest speed at its start, without impulses or to close its gaps.
void DenseStepTangent::set_scale() {
  const DenseStepRecord& s = *record_;
  const DenseStepRecord::Place& free = s.places[0];
  scale_ = {};
  const int others = rows_ - constraints_;
  if (others == 0) return;
  scale_.impulse =
      std::max(s.lambda.tail(others).lpNorm<Eigen::Infinity>(), s.plastic.tail(others).lpNorm<Eigen::Infinity>());
  const auto W = s.W0.rightCols(others).transpose();
  const auto own = own0_.tail(others);
  scale_.speed = std::max((W * v0_ + own).lpNorm<Eigen::Infinity>(), (W * free.v + own).lpNorm<Eigen::Infinity>());
  for (std::size_t i = 0; i < s.contacts.size(); ++i)
    scale_.speed = std::max(scale_.speed, std::abs(free.end[i].gap - s.contacts[i].allowed) / s.h);
}

// The geometry of the contacts at the start, at the places with which slips are made, and at the end.
void DenseStepTangent::take_geometry() {
  const DenseStepRecord& s = *record_;
  const std::size_t n = s.contacts.size(), places = s.places.size();
  std::vector<Contact> start, end;
  std::vector<Vec3> t1_start, t1_end;
  for (const DenseStepRecord::Contact& c : s.contacts) {
    start.push_back(c.start);
    end.push_back(c.end);
    t1_start.push_back(c.t1_start);
    t1_end.push_back(c.t1_end);
  }
  take_sites(start_, s.q0, s.t, start, t1_start, own0_, own0_rate_);
  take_sites(end_, s.places.back().q, s.t + s.h, end, t1_end, own1_, own1_rate_);
  if (slip_.size() < places) slip_.resize(places);
  slip_own_.assign(places, VecX::Zero(rows_));
  slip_own_rate_ = slip_own_;
  std::vector<char> wanted(places, 0);
  for (const DenseStepRecord::Round& round : s.rounds)
    for (char lasting : round.lasting) wanted[round.slips] |= lasting;
  for (std::size_t k = 0; k < wanted.size(); ++k) {
    const DenseStepRecord::Place& place = s.places[k];
    if (wanted[k] != 0) take_sites(slip_[k], place.q, s.t + s.h, place.end, place.t1, slip_own_[k], slip_own_rate_[k]);
  }
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
  down0_.setZero(rows_);
  down1_.setZero(rows_);
  if (constraints_ == 0) return;
  start_constraints_.take(s.q0, s.t);
  end_rates_.clear();
  for (const DenseStepRecord::Place& place : s.places) {
    end_constraints_.take(place.q, s.t + s.h);
    end_rates_.push_back(end_constraints_.rates());
  }
}

// The contacts at the end q of a motion or its start, at the time t. own: as own0_.
void DenseStepTangent::take_sites(std::vector<Site>& sites, const VecX& q, double t, const std::vector<Contact>& at,
                                  const std::vector<Vec3>& t1, VecX& own, VecX& rate) {
  const DenseStepRecord& s = *record_;
  while (sites.size() < at.size()) sites.emplace_back(*scene_);
  own.setZero(rows_);
  rate.setZero(rows_);
  bool placed = false;
  for (std::size_t i = 0; i < at.size(); ++i) {
    const DenseStepRecord::Contact& c = s.contacts[i];
    const int guard = c.point.guard;
    auto& [contact, surface] = sites[i];
    if (!contact.take(q, guard, at[i], &c.law))
      refuse("witness", guard, "The gap of a contact has no second derivative", "one pair of nearest points",
             contact.why(), "Start elsewhere, or round the edges of the shapes");
    surface = SurfaceVelocityTangent();
    if (c.mu == 0.0) continue;
    if (contact.has_axis()) {
      if (!placed) guards_.place(q);
      placed = true;
      // Files of older versions have other tangents at places within a step.
      if ((t1[i] - guards_.tangent(guard, at[i].normal)).norm() > kOnCone) require_plain_law(*scene_, guard, s.t);
    }
    surface.take(*scene_, guard, contact, t1[i], t);
    own.segment<2>(c.row + 1) = surface.velocity();
    rate.segment<2>(c.row + 1) = surface.rate();
  }
}

// Friction and restitution that depend on speeds are those of the speeds at the start.
void DenseStepTangent::take_coefficients() {
  const DenseStepRecord& s = *record_;
  coefficients_.assign(s.contacts.size(), {});
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const DenseStepRecord::Contact& c = s.contacts[i];
    const int guard = c.point.guard;
    const ContactLaw* law = scene_->law(guard);
    if (law == nullptr) continue;
    Coefficients& found = coefficients_[i];
    const Eigen::Array2d shares = start_[i].contact.shares();
    Eigen::Vector2d slip = Eigen::Vector2d::Zero();
    if (c.mu > 0.0) {
      const Eigen::Vector2d w = s.W0.middleCols<2>(c.row + 1).transpose() * v0_ + own0_.segment<2>(c.row + 1);
      slip = w.array() / shares;
    }
    if (restitution_varies(*law)) {
      const double closing = -s.W0.col(c.row).dot(v0_);
      found.own_e = false;
      if (closing > 0.0 && c.restitution > 0.0 && (law->e.given() || c.expands)) {
        const Vec3 slopes = restitution_slopes(*law, closing, slip.norm(), s.t);
        found.e_by_closing = -slopes[0];
        if (slip.norm() > 0.0) found.e_by_slip = slopes[1] * (slip.normalized().array() / shares).matrix();
        found.e_by_time = slopes[2];
      }
    }
    if (c.mu == 0.0 || !scene_->friction_varies(guard)) continue;
    const bool sticks = slip.norm() <= kStill * (1.0 + v0_.cwiseAbs().maxCoeff());
    found.own_mu = takes_friction(*scene_, guard, sticks);
    // What carries a load from the last step sticks at its end along all directions.
    const auto lasts = [&](const DenseStepRecord::Round& round) { return round.lasting[i] != 0; };
    if (sticks && std::none_of(s.rounds.begin(), s.rounds.end(), lasts)) {
      found.without_rest = scene_->sliding_friction(guard, 0.0);
    } else if (!sticks && law->mu.given()) {
      found.mu_by_slip = law->mu.slope(slip.norm()) * (slip.normalized().array() / shares).matrix();
    }
  }
}

void DenseStepTangent::take_masses(const VecX& tau, const Servo* servo) {
  const DenseStepRecord& s = *record_;
  if (!start_masses_.node_velocity(s.q0, s.p0, v0_)) throw Error("the mass matrix is not positive definite");
  q_stage_ = s.q0;
  integrate(scene_->tree, s.q0, v0_, 0.5 * s.h, q_stage_);
  D_.compute(s.D);
  DinvW_ = D_.solve(s.W0);
  if (has_friction_) step_masses_.take(s, tau, servo, v0_);
}

void DenseStepTangent::take_free(const VecX& tau, const Servo* servo) {
  const DenseStepRecord& s = *record_;
  const DenseStepRecord::Place& place = s.places[0];
  VecX p = s.p0;
  if (constraints_ > 0) p += s.W0.leftCols(constraints_) * place.lambda.head(constraints_);
  free_.take(s.q0, p, s.h, tau, s.t, servo, place.v);
  if (constraints_ == 0) return;
  MatX P;
  unit_changes(free_, constraints_, free_constraints_.Q, P, free_constraints_.V);
  free_constraints_.system.compute(place.W.leftCols(constraints_).transpose() * free_constraints_.Q / s.h,
                                   constraints_);
}

// Of a step: the changes of its end, of the momentum there and of the velocity per unit of the first impulses.
void DenseStepTangent::unit_changes(StepTangent& step, int rows, MatX& Q, MatX& P, MatX& V) {
  if (!step.unit_changes(record_->W0.leftCols(rows), Q, P, V))
    refuse("step", -1, "The derivative of a step was not solved", "tangent equations with a solution", "none",
           "Use a smaller dt");
}

void DenseStepTangent::take_round(std::size_t k, const VecX& tau, const Servo* servo) {
  const DenseStepRecord& s = *record_;
  const DenseStepRecord::Round& r = s.rounds[k];
  const DenseStepRecord::Place &about = s.places[r.about], &slips = s.places[r.slips], &next = s.places[k + 1];
  Round& round = rounds_[k];
  round.lambda = k + 1 == s.rounds.size() ? s.lambda : next.lambda;
  VecX w = s.W0.transpose() * r.v + own0_;
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const DenseStepRecord::Contact& c = s.contacts[i];
    if (r.present[i] == 0) {  // it had joined later: open
      w[c.row] = 1.0 + scale_.speed;
      continue;
    }
    w[c.row] += (about.end[i].gap - c.allowed) / s.h - s.W0.col(c.row).dot(about.v);
    if (r.lasting[i] == 0) continue;
    for (int t = c.row + 1; t < c.row + 3; ++t)
      w[t] += 0.5 * ((slips.W.col(t) - s.W0.col(t)).dot(slips.v) + slip_own_[r.slips][t] - own0_[t]);
  }
  VecX box = VecX::Zero(rows_);
  for (std::size_t j = 0; j < s.joints.size(); ++j) box[s.row_of(j)] = 0.5 * s.h * s.joints[j].limit;
  round.law.take_law(s, r.lambda, w, s.W0.transpose() * DinvW_, VecX::Zero(rows_), box, scale_);
  if (has_friction_) note(round.law);
  if (has_friction_) round.mass_effect = step_masses_.effect(r.v - s.places[r.anew ? 0 : r.about].v);
  round.step.take(s.q0, s.p0 + s.W0 * (round.lambda - pull0_), s.h, tau, s.t, servo, next.v);
  unit_changes(round.step, rows_, round.Q, round.P, round.V);
  std::vector<double> gaps;
  for (std::size_t i = 0; i < s.contacts.size(); ++i) gaps.push_back(next.end[i].gap - s.contacts[i].allowed);
  round.gaps.take_gaps(s, round.lambda, gaps, next.W.transpose() * round.Q / s.h);
  check_round(round);
}

// What the laws leave open must have no effect. Where it has, the solver's way decides about the motion.
void DenseStepTangent::check_shared(const DenseLaws& laws, const MatX& effect) {
  const MatX& free = laws.free();
  if (free.cols() > 0 && (effect * free).cwiseAbs().maxCoeff() > kShared * effect.cwiseAbs().maxCoeff())
    refuse_shared("The motion depends on how contact points share their load",
                  "points that turn while they slip, or land together", "Use fewer points (contact_points=3)");
}

void DenseStepTangent::refuse_shared(const char* fact, const char* got, const char* remedy) {
  approximate("points whose shares of a load decide about the motion");
  if (kinks_->taken()) return;
  const std::string other = ", or on_kink='taken' for the derivative with impulses of least norm";
  refuse("redundant", record_->contacts.empty() ? -1 : record_->contacts[0].point.guard, fact,
         "a motion that the laws of contact determine", got, (remedy + other).c_str());
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
  for (std::size_t j = 0; j < s.joints.size(); ++j) box[s.row_of(j)] = 0.5 * s.h * s.joints[j].limit;
  // A contact that takes no part is open: its speed is as large as can be.
  const auto speeds = [&](const VecX& v) {
    VecX w = s.W1.transpose() * v + own1_;
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
    const Eigen::Index r = s.row_of(j);
    box[r] = std::max(kLeastDivisor, box[r] - std::abs(s.plastic[r]));
  }
  expansion_.lambda = s.plastic + s.expansion;
  expansion_.v = s.v_expansion;
  expansion_.laws.take_law(s, s.expansion, speeds(s.v_expansion), G_, low, box, scale_);
  note(expansion_.laws);
  check_shared(expansion_.laws, MinvW_);
  check_expansion();
  if (s.expanded < 1.0) take_energy();
}

// Restitution depends on the normal impulses themselves, also where the motion before it does not.
void DenseStepTangent::check_expansion() {
  const DenseStepRecord& s = *record_;
  const Round& last = rounds_[s.rounds.size() - 1];
  const double all = MinvW_.cwiseAbs().maxCoeff();
  const auto check = [&](const VecX& lambda, bool at_end) {
    VecX known = VecX::Zero(rows_);
    for (const DenseStepRecord::Contact& c : s.contacts)
      if (c.expands) known[c.row] = c.restitution * lambda[c.row];
    for (std::size_t j = 0; at_end && j < s.joints.size(); ++j)
      known[s.row_of(j)] = -std::copysign(1.0, s.plastic[s.row_of(j)]) * lambda[s.row_of(j)];
    if ((MinvW_ * expansion_.laws.from_known(known)).cwiseAbs().maxCoeff() > kShared * all)
      refuse_shared("Restitution depends on how an impulse is shared",
                    "points that land together, or friction of a mechanism with one motion",
                    "Use fewer points (contact_points=3), no friction or no restitution");
  };
  for (Eigen::Index k = 0; k < plastic_.laws.free().cols(); ++k) check(plastic_.laws.free().col(k), true);
  for (Eigen::Index k = 0; k < last.gaps.free().cols(); ++k) check(last.gaps.free().col(k), false);
  for (Eigen::Index k = 0; has_friction_ && k < last.law.free().cols(); ++k) {
    VecX known = last.law.free().col(k);
    low_changes(last, VecX(), known);
    check(last.gaps.from_known(known), false);
  }
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

#include "sensitivity/dense_step_adjoint.hpp"

#include <cmath>

#include "sensitivity/stage_velocity.hpp"

namespace contactvi {

DenseStepAdjoint::DenseStepAdjoint(const Scene& scene, Kinks& kinks)
    : scene_(&scene), tangent_(scene, kinks), adjoint_(scene.tree, 1), work_(scene.tree.nv) {}

void DenseStepAdjoint::take(const DenseStepRecord& step, const VecX& tau, const Servo* servo) {
  record_ = &step;
  tau_ = tau;
  servo_ = servo;
  tangent_.take(step, tau, servo);
  set_matrices();
}

// What the forward functions have left per unit of one degree of freedom of a source.
void DenseStepAdjoint::fill(Source& source, int dof) {
  DenseStepTangent& t = tangent_;
  const DenseStepRecord& s = *record_;
  const VecX& none = t.none_;
  VecX slip;
  source.W0[dof] = t.dW0_;
  source.own0.col(dof) = t.down0_;
  for (std::size_t k = 0; k < s.places.size(); ++k) {
    source.gaps[k].col(dof) = t.extra_gaps(s.places[k]);
    if (slips_[k].of_q.size() == 0) continue;
    t.slip_change(static_cast<int>(k), none, none, 0.0, slip);
    source.slips[k].col(dof) = slip;
  }
  t.set_end_rows(none, 0.0);
  source.W1[dof] = t.dW1_;
  source.own1.col(dof) = t.down1_;
}

void DenseStepAdjoint::set_matrices() {
  DenseStepTangent& t = tangent_;
  const DenseStepRecord& s = *record_;
  const int n = scene_->tree.nv;
  const VecX& none = t.none_;
  VecX unit = none, slip;
  slips_.assign(s.places.size(), Slips());
  for (const DenseStepRecord::Round& round : s.rounds)
    for (char lasting : round.lasting)
      if (lasting != 0)
        for (MatX* X : {&slips_[round.slips].of_q, &slips_[round.slips].of_v}) X->setZero(t.rows_, n);
  sources_.clear();
  sources_.push_back({-1, {}, {}, {}, {}, {}, {}});
  for (int k = 0; k < static_cast<int>(s.places.size()); ++k)
    for (std::size_t i = 0; i < s.contacts.size(); ++i)
      if (t.is_found_[i] != 0 && s.contacts[i].found == k) {
        sources_.push_back({k, {}, {}, {}, {}, {}, {}});
        break;
      }
  W1_of_q1_.assign(static_cast<std::size_t>(n), MatX());
  own1_of_q1_.setZero(t.rows_, n);
  for (Source& source : sources_) {
    source.W0.resize(static_cast<std::size_t>(n));
    source.W1.resize(static_cast<std::size_t>(n));
    source.gaps.assign(s.places.size(), MatX::Zero(t.rows_, n));
    source.slips = source.gaps;
    source.own0.setZero(t.rows_, n);
    source.own1.setZero(t.rows_, n);
    for (int d = 0; d < n; ++d) {
      unit[d] = 1.0;
      t.clear_law_changes();
      t.set_start_rows(source.place < 0 ? unit : none, 0.0);
      if (source.place >= 0) t.add_found_rows(source.place, unit);
      fill(source, d);
      unit[d] = 0.0;
    }
  }
  t.clear_law_changes();
  t.set_start_rows(none, 0.0);
  for (int d = 0; d < n; ++d) {
    unit[d] = 1.0;
    t.set_end_rows(unit, 0.0);
    W1_of_q1_[d] = t.dW1_;
    own1_of_q1_.col(d) = t.down1_;
    for (std::size_t k = 0; k < s.places.size(); ++k) {
      if (slips_[k].of_q.size() == 0) continue;
      t.slip_change(static_cast<int>(k), unit, none, 0.0, slip);
      slips_[k].of_q.col(d) = slip;
      t.slip_change(static_cast<int>(k), none, unit, 0.0, slip);
      slips_[k].of_v.col(d) = slip;
    }
    unit[d] = 0.0;
  }
}

// Gradients in the changes of the rows at the start and the end, of the gaps and of the slips of a place.
void DenseStepAdjoint::pass_rows(const MatX& lW0, const MatX& lW1) {
  for (const Source& source : sources_)
    for (Eigen::Index d = 0; d < lq0_.size(); ++d) {
      if (lW0.size() > 0) of(source)[d] += source.W0[d].cwiseProduct(lW0).sum();
      if (lW1.size() > 0) of(source)[d] += source.W1[d].cwiseProduct(lW1).sum();
    }
  const int m = tangent_.constraints_;
  if (m == 0) return;
  if (lW0.size() > 0) lt_ += tangent_.start_constraints_.gradient_rates().cwiseProduct(lW0.leftCols(m)).sum();
  if (lW1.size() == 0) return;
  const double later = tangent_.end_constraints_.gradient_rates().cwiseProduct(lW1.leftCols(m)).sum();
  lt_ += later;
  lh_ += later;
}

void DenseStepAdjoint::pass_gaps(int place, const VecX& lgaps) {
  for (const Source& source : sources_) of(source) += source.gaps[place].transpose() * lgaps;
}

// The transpose of DenseStepTangent::end_times(), over the length; lrows: gradients in the rows of a place.
void DenseStepAdjoint::pass_end_times(std::size_t place, const VecX& lrows) {
  if (tangent_.constraints_ == 0) return;
  const double l = tangent_.end_rates_[place].dot(lrows.head(tangent_.constraints_)) / record_->h;
  lt_ += l;
  lh_ += l;
}

void DenseStepAdjoint::pass_slips(int place, const VecX& lslips) {
  places_[place].q += slips_[place].of_q.transpose() * lslips;
  places_[place].v += slips_[place].of_v.transpose() * lslips;
  for (const Source& source : sources_) of(source) += source.slips[place].transpose() * lslips;
  const double later = 0.5 * tangent_.slip_own_rate_[place].dot(lslips);
  lt_ += later - 0.5 * tangent_.own0_rate_.dot(lslips);
  lh_ += later;
}

// The transpose of DenseStepTangent::coefficient_changes(). Adds to the gradients in the rows at the start and in the
// velocities of surfaces there.
void DenseStepAdjoint::pass_coefficients(const VecX& lmu, const VecX& le, MatX& lW0, VecX& lown0) {
  const DenseStepTangent& t = tangent_;
  const DenseStepRecord& s = *record_;
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    const DenseStepTangent::Coefficients& c = t.coefficients_[i];
    const int r = s.contacts[i].row;
    if (c.own_mu) lmu_[k] += lmu[k];
    if (c.own_e) le_[k] += le[k];
    if (c.e_by_closing != 0.0) {
      const double l = c.e_by_closing * le[k];
      lW0.col(r) += l * t.v0_;
      lv0_ += l * s.W0.col(r);
    }
    lt_ += c.e_by_time * le[k];
    if (c.mu_by_slip.isZero(0.0) && c.e_by_slip.isZero(0.0)) continue;
    const Eigen::Vector2d l = lmu[k] * c.mu_by_slip + le[k] * c.e_by_slip;
    lW0.middleCols<2>(r + 1) += t.v0_ * l.transpose();
    lv0_ += s.W0.middleCols<2>(r + 1) * l;
    lown0.segment<2>(r + 1) += l;
  }
}

// Gradients in the changes of the velocities of surfaces at the start and the end.
void DenseStepAdjoint::pass_own(const VecX& lown0, const VecX& lown1) {
  for (const Source& source : sources_) of(source) += source.own0.transpose() * lown0 + source.own1.transpose() * lown1;
  places_.back().q += own1_of_q1_.transpose() * lown1;
  const double later = tangent_.own1_rate_.dot(lown1);
  lt_ += tangent_.own0_rate_.dot(lown0) + later;
  lh_ += later;
}

// The transpose of DenseStepTangent::pull_change().
void DenseStepAdjoint::pass_pull(bool at_end, const VecX& lpull) {
  const DenseStepTangent& t = tangent_;
  const double later = (at_end ? t.pull1_rate_ : t.pull0_rate_).dot(lpull);
  lh_ += (at_end ? t.pull1_ : t.pull0_).dot(lpull) / record_->h + (at_end ? later : 0.0);
  lt_ += later;
}

// The transpose of DenseStepTangent::end_base().
void DenseStepAdjoint::pass_end_base(const DenseStepTangent::End& end, const VecX& lbase, StepParameters& sums) {
  const VecX& q1 = record_->places.back().q;
  const VecX m = tangent_.MinvW_ * lbase;
  lp_minus_ += m;
  lW1_ += m * (end.lambda - tangent_.pull1_).transpose() + end.v * lbase.transpose();
  pass_pull(true, -(record_->W1.transpose() * m));
  lown1_ += lbase;
  VecX lq(m.size());
  adjoint_.momentum(q1, end.v, -m, lq, work_);
  places_.back().q += lq;
  adjoint_.add_momentum_parameters(q1, end.v, -m, sums);
  if (tangent_.constraints_ == 0) return;
  const VecX lrates = lbase.head(tangent_.constraints_);
  const double later = tangent_.end_constraints_.accelerations().dot(lrates);
  lt_ += later;
  lh_ += later;
  places_.back().q += tangent_.end_constraints_.gradient_rates() * lrates;
}

void DenseStepAdjoint::pass_end(const VecX& lq, const VecX& lp, StepParameters& sums) {
  const DenseStepTangent& t = tangent_;
  const DenseStepRecord& s = *record_;
  DenseStepAdjoint::Change& end = places_.back();
  VecX lp1 = lp, lbase, lknown, lmu, lmus = VecX::Zero(lmu_.size()), les = lmus, lown0 = VecX::Zero(t.rows_);
  MatX lW0 = MatX::Zero(lq.size(), t.rows_);
  lown1_ = lown0;
  end.q += lq;
  const bool expands = s.expansion.size() > 0;
  if (expands && s.expanded < 1.0) {
    const double c = lp.dot(s.W1 * s.expansion) / t.expansion_rate_;
    lq0_ += c * t.energy_q0_;
    lp0_ += c * t.v0_;
    end.q -= c * t.energy_q1_;
    lp1 -= c * s.v1;
  }
  VecX total = s.plastic;
  if (expands) total += s.expanded * s.expansion;
  lp_minus_ = lp1;
  lW1_ = lp1 * (total - t.pull1_).transpose();
  pass_pull(true, -(s.W1.transpose() * lp1));
  VecX lplastic = s.W1.transpose() * lp1;
  if (expands) {
    t.expansion_.laws.solve_transposed(s.expanded * lplastic, lbase, lknown, lmu);
    lmus += lmu;
    for (std::size_t j = 0; j < s.joints.size(); ++j) {
      const Eigen::Index r = s.row_of(j);
      lh_ += 0.5 * s.joints[j].limit * lknown[r];
      lplastic[r] -= std::copysign(1.0, s.plastic[r]) * lknown[r];
    }
    for (std::size_t i = 0; i < s.contacts.size(); ++i) {
      const DenseStepRecord::Contact& c = s.contacts[i];
      if (!c.expands) continue;
      end.lambda[c.row] += c.restitution * lknown[c.row];
      lplastic[c.row] += c.restitution * lknown[c.row];
      les[static_cast<Eigen::Index>(i)] += (s.lambda[c.row] + s.plastic[c.row]) * lknown[c.row];
    }
    lplastic += t.G_.transpose() * lbase;
    pass_end_base(t.expansion_, lbase, sums);
  }
  t.plastic_.laws.solve_transposed(lplastic, lbase, lknown, lmu);
  lmus += lmu;
  for (std::size_t j = 0; j < s.joints.size(); ++j) lh_ += 0.5 * s.joints[j].limit * lknown[s.row_of(j)];
  pass_end_base(t.plastic_, lbase, sums);
  for (Eigen::Index d = 0; d < lq.size(); ++d) end.q[d] += W1_of_q1_[d].cwiseProduct(lW1_).sum();
  pass_coefficients(lmus, les, lW0, lown0);
  pass_rows(lW0, lW1_);
  pass_own(lown0, lown1_);
}

// The smooth step from p_start to a place: lq, lv, lp in its end, the velocity and the momentum there.
bool DenseStepAdjoint::pass_step(const VecX& p_start, const DenseStepRecord::Place& place, const VecX& lq,
                                 const VecX& lv, const VecX& lp, VecX& lp_start, StepParameters& sums) {
  const DenseStepRecord& s = *record_;
  const int n = scene_->tree.nv;
  adjoint_.take(s.q0, p_start, s.h, tau_, s.t, servo_, place.v);
  VecX lq1 = lq, lq0(n), ltau(n);
  fold_velocity(scene_->tree, s.h, place.v, lv, lq0_, lq1, lh_);
  double lh = 0.0;
  lp_start.resize(n);
  if (!adjoint_.solve(lq1, lp, lq0, lp_start, lh, ltau)) return false;
  adjoint_.add_time(lt_, lh);
  adjoint_.add_parameters(sums);
  lq0_ += lq0;
  lp0_ += lp_start;
  lh_ += lh;
  ltau_ += ltau;
  return true;
}

// The transpose of DenseStepTangent::matrix_change().
void DenseStepAdjoint::pass_masses(const DenseStepTangent::Round& round, const VecX& u, const VecX& l,
                                   StepParameters& sums) {
  const double h = record_->h;
  const int n = scene_->tree.nv;
  lq0_ += round.mass_effect.leftCols(n).transpose() * l;
  lv0_ += round.mass_effect.middleCols(n, n).transpose() * l;
  places_[0].v += round.mass_effect.middleCols(2 * n, n).transpose() * l;
  lh_ += round.mass_effect.col(3 * n).dot(l);
  adjoint_.add_momentum_parameters(tangent_.q_stage_, u, l, sums);
  const VecX product = u.cwiseProduct(l);
  sums.damping += 0.5 * h * product;
  sums.kd += 0.5 * h * product;
  sums.kp += 0.25 * h * h * product;
  for (std::size_t k = 0; k < scene_->tree.joints.size(); ++k) {
    const Joint& joint = scene_->tree.joints[k];
    sums.stiffness[static_cast<Eigen::Index>(k)] += 0.25 * h * h * product.segment(joint.iv, joint.nv).sum();
  }
}

bool DenseStepAdjoint::pass_round(std::size_t k, StepParameters& sums) {
  const DenseStepTangent& t = tangent_;
  const DenseStepRecord& s = *record_;
  const DenseStepRecord::Round& r = s.rounds[k];
  const DenseStepRecord::Place &about = s.places[r.about], &from = s.places[r.anew ? 0 : r.about],
                               &to = s.places[k + 1];
  const DenseStepTangent::Round& round = t.rounds_[k];
  const bool last = k + 1 == s.rounds.size();
  const VecX none = VecX::Zero(scene_->tree.nv);
  const VecX lp = last ? lp_minus_ : none;
  Change& next = places_[k + 1];
  VecX lbase, lknown, lmu;
  // The gap iterations.
  const VecX llambda =
      next.lambda + round.Q.transpose() * next.q + round.V.transpose() * next.v + round.P.transpose() * lp;
  round.gaps.solve_transposed(llambda, lbase, lknown, lmu);
  const VecX lq = next.q + to.W * lbase / s.h;
  pass_gaps(static_cast<int>(k) + 1, lbase / s.h);
  pass_end_times(k + 1, lbase);
  for (std::size_t i = 0; i < s.contacts.size(); ++i)
    lallowed_[static_cast<Eigen::Index>(i)] -= lbase[s.contacts[i].row] / s.h;
  VecX lp_start;
  const VecX acting = round.lambda - t.pull0_;
  if (!pass_step(s.p0 + s.W0 * acting, to, lq, next.v, lp, lp_start, sums)) return false;
  MatX lW0 = lp_start * acting.transpose();
  pass_pull(false, -(s.W0.transpose() * lp_start));
  VecX lown0 = VecX::Zero(t.rows_);
  if (t.has_friction_) {
    VecX lmus = VecX::Zero(lmu_.size());
    const std::vector<DenseLaws::Contact>& gaps = round.gaps.contacts();
    for (std::size_t i = 0; i < gaps.size(); ++i) {
      const DenseLaws::Contact& c = gaps[i];
      const double low = lknown[c.row];
      lknown[c.row] = 0.0;
      if (c.normal != DenseLaws::Normal::kBound || c.mu == 0.0) continue;
      const Eigen::Vector2d along = round.lambda.segment<2>(c.row + 1);
      const double size = along.norm();
      if (!(size > 0.0)) continue;
      lknown.segment<2>(c.row + 1) += low / (size * c.mu) * along;
      lmus[static_cast<Eigen::Index>(i)] -= size / (c.mu * c.mu) * low;
    }
    // The law.
    const VecX llaw = lknown;
    round.law.solve_transposed(llaw, lbase, lknown, lmu);
    pass_coefficients(lmus + lmu, VecX::Zero(lmu_.size()), lW0, lown0);
    lown0 += lbase;
    for (std::size_t j = 0; j < s.joints.size(); ++j) lh_ += 0.5 * s.joints[j].limit * lknown[s.row_of(j)];
    lW0 += r.v * lbase.transpose();
    VecX lgaps = VecX::Zero(t.rows_), lslips = lgaps;
    const VecX lv = s.W0 * lbase, lforce = t.D_.solve(lv);
    bool lasting = false;
    for (std::size_t i = 0; i < s.contacts.size(); ++i) {
      const DenseStepRecord::Contact& c = s.contacts[i];
      const double l = lbase[c.row], gap = about.end[i].gap - c.allowed;
      places_[r.about].q += l / s.h * about.W.col(c.row);
      places_[r.about].v -= l * s.W0.col(c.row);
      lgaps[c.row] = l / s.h;
      lallowed_[static_cast<Eigen::Index>(i)] -= l / s.h;
      if (l != 0.0) lh_ -= gap / (s.h * s.h) * l;
      lW0.col(c.row) -= l * about.v;
      if (r.lasting[i] == 0) continue;
      lasting = true;
      lslips.segment<2>(c.row + 1) = lbase.segment<2>(c.row + 1);
    }
    pass_gaps(r.about, lgaps);
    if (lasting) pass_slips(r.slips, lslips);
    Change& from_change = places_[r.anew ? 0 : r.about];
    from_change.v += lv;
    if (t.constraints_ > 0) {
      const VecX l = lbase.head(t.constraints_);
      lW0.leftCols(t.constraints_) -= from.v * l.transpose();
      from_change.v -= s.W0.leftCols(t.constraints_) * l;
    }
    lW0 += lforce * (r.lambda - (r.anew ? t.pull0_ : about.lambda)).transpose();
    if (r.anew) pass_pull(false, -(s.W0.transpose() * lforce));
    if (!r.anew) places_[r.about].lambda -= s.W0.transpose() * lforce;
    pass_masses(round, r.v - from.v, -lforce, sums);
  }
  pass_rows(lW0, MatX());
  pass_own(lown0, VecX::Zero(t.rows_));
  return true;
}

// The transpose of DenseStepTangent::solve_free().
bool DenseStepAdjoint::pass_free(StepParameters& sums) {
  const DenseStepTangent& t = tangent_;
  const DenseStepRecord& s = *record_;
  const DenseStepRecord::Place& place = s.places[0];
  const int m = t.constraints_;
  Change& free = places_[0];
  VecX p = s.p0, lp_start;
  if (m > 0) {
    p += s.W0.leftCols(m) * place.lambda.head(m);
    const VecX lmu =
        free.lambda.head(m) + t.free_constraints_.Q.transpose() * free.q + t.free_constraints_.V.transpose() * free.v;
    const VecX lbase = t.free_constraints_.system.solve_transposed(lmu);
    free.q += place.W.leftCols(m) * lbase / s.h;
    pass_end_times(0, lbase);
  }
  if (!pass_step(p, place, free.q, free.v, VecX::Zero(scene_->tree.nv), lp_start, sums)) return false;
  if (m == 0) return true;
  MatX lW0 = MatX::Zero(scene_->tree.nv, t.rows_);
  lW0.leftCols(m) = lp_start * place.lambda.head(m).transpose();
  pass_rows(lW0, MatX());
  return true;
}

bool DenseStepAdjoint::solve(const VecX& lq, const VecX& lp, DenseStepGradient& g, StepParameters& sums) {
  const DenseStepTangent& t = tangent_;
  const DenseStepRecord& s = *record_;
  const int n = scene_->tree.nv;
  const auto contacts = static_cast<Eigen::Index>(s.contacts.size());
  places_.assign(s.places.size(), {VecX::Zero(n), VecX::Zero(n), VecX::Zero(t.rows_)});
  for (VecX* x : {&lq0_, &lp0_, &lv0_, &lp_minus_, &ltau_}) x->setZero(n);
  for (VecX* x : {&lmu_, &le_, &lallowed_}) x->setZero(contacts);
  lt_ = lh_ = 0.0;
  pass_end(lq, lp, sums);
  for (std::size_t k = s.rounds.size(); k-- > 0;)
    if (!pass_round(k, sums)) return false;
  if (!pass_free(sums)) return false;
  // The velocity at the start.
  tangent_.start_masses_.place_node(s.q0);
  VecX m = lv0_, lq0(n);
  tangent_.start_masses_.solve_mass(m);
  lp0_ += m;
  adjoint_.momentum(s.q0, t.v0_, -m, lq0, work_);
  lq0_ += lq0;
  adjoint_.add_momentum_parameters(s.q0, t.v0_, -m, sums);
  for (Eigen::Index i = 0; i < contacts; ++i) {
    const DenseStepRecord::Contact& c = s.contacts[static_cast<std::size_t>(i)];
    if (!(c.allowed < 0.0)) continue;
    lq0_ += lallowed_[i] * s.W0.col(c.row);
    lh_ += s.allowed_rate * lallowed_[i];
  }
  g = {lq0_, lp0_, lt_, lh_, ltau_, lmu_, le_};
  return true;
}

}  // namespace contactvi

// DenseStepTangent: the changes along a direction.
#include <algorithm>
#include <cmath>

#include "model/coupling.hpp"
#include "sensitivity/dense_step_tangent.hpp"
#include "sensitivity/kinks.hpp"

namespace contactvi {

namespace {
// Of a momentum: where the masses of a step's law change by less within it they count as one matrix.
constexpr double kOneMatrix = 1e-7;
}  // namespace

void DenseStepTangent::set_start_rows(const VecX& dq0, double dt) {
  const DenseStepRecord& s = *record_;
  dW0_.setZero();
  down0_.setZero();
  if (constraints_ > 0) start_constraints_.change(dq0, dt, dW0_.leftCols(constraints_));
  twists_.place(s.q0);
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const DenseStepRecord::Contact& c = s.contacts[i];
    auto dW = dW0_.middleCols(c.row, c.mu > 0.0 ? 3 : 1);
    auto& [contact, surface] = start_[i];
    contact.change(dq0, c.t1_start, dW);
    dn0_[i] = contact.normal_change();
    if (surface.moves()) down0_.segment<2>(c.row + 1) = surface.change(contact) + dt * surface.rate();
    if (is_found_[i] != 0 && c.found < 0) {
      twists_.move(dq0);
      set_law_change(i, c.start, dq0);
      twists_.move(none_);
      const Extra more = extra(i, start_[i], c.start, c.t1_start, dW);
      dn0_[i] += more.normal;
      if (c.mu > 0.0) down0_.segment<2>(c.row + 1) += more.own;
    }
    dt1_[i] = -dn0_[i].dot(c.t1_start) * c.start.normal;
  }
}

// The rows at the start of the points that were found at a place, whose end moves by dq; after set_start_rows.
void DenseStepTangent::add_found_rows(int place, const VecX& dq) {
  const DenseStepRecord& s = *record_;
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const DenseStepRecord::Contact& c = s.contacts[i];
    if (is_found_[i] == 0 || c.found != place) continue;
    twists_.place(s.places[place].q);
    twists_.move(dq);
    set_law_change(i, s.places[place].end[i], dq);
    twists_.place(s.q0);
    twists_.move(none_);
    auto dW = dW0_.middleCols(c.row, c.mu > 0.0 ? 3 : 1);
    const Extra more = extra(i, start_[i], c.start, c.t1_start, dW);
    dn0_[i] += more.normal;
    if (c.mu > 0.0) down0_.segment<2>(c.row + 1) += more.own;
    dt1_[i] = -dn0_[i].dot(c.t1_start) * c.start.normal;
  }
}

// The bodies are placed where the point was found, with this contact, and moved along dq.
void DenseStepTangent::set_law_change(std::size_t i, const Contact& at, const VecX& dq) {
  const DenseStepRecord::Contact& c = record_->contacts[i];
  const ContactPoint &law = c.law, &point = c.point;
  const Pose own = pose_of(law.point_body, twists_.placements()), plane = pose_of(law.plane_body, twists_.placements());
  LawChange& change = law_change_[i];
  change = {Vec3::Zero(), Vec3::Zero(), 0.0};
  if (point.kind == PointKind::kRim) {
    // The lowest point of the circle.
    const Vec3 n = plane.R * point.normal_B, a = own.R * point.axis_B;
    const Vec3 dn = (twists_.turn(law.plane_body) - twists_.turn(law.point_body)).cross(n);
    const Vec3 down = n.dot(a) * a - n, ddown = dn.dot(a) * a - dn;
    const double length = down.norm();
    const Vec3 along = down / length;
    change.center = own.R.transpose() * (point.rim_radius / length * (ddown - along.dot(ddown) * along));
    return;
  }
  MatX dW(scene_->tree.nv, 3);
  found_[i].change(dq, any_tangent(at.normal), dW);
  const Vec3 slide_a = found_[i].point_a_change() - twists_.velocity(law.plane_body, at.point_a);
  const Vec3 slide_b = found_[i].point_b_change() - twists_.velocity(law.point_body, at.point_b);
  change.center = own.R.transpose() * slide_b;
  change.normal = plane.R.transpose() * (found_[i].normal_change() - twists_.turn(law.plane_body).cross(at.normal));
  change.offset = change.normal.dot(plane.into(at.point_a)) + at.normal.dot(slide_a);
}

// Where the bodies are placed.
DenseStepTangent::Extra DenseStepTangent::extra_gap(std::size_t i, const Contact& at) const {
  const ContactPoint& law = record_->contacts[i].law;
  const LawChange& change = law_change_[i];
  const Pose own = pose_of(law.point_body, twists_.placements()), plane = pose_of(law.plane_body, twists_.placements());
  const Vec3 outward = law.on_b ? at.normal : Vec3(-at.normal);
  Extra found;
  found.normal = plane.R * change.normal;
  found.gap =
      change.normal.dot(plane.into(own.point(law.center_B))) + outward.dot(own.R * change.center) - change.offset;
  if (!law.on_b) found.normal = -found.normal;
  return found;
}

VecX DenseStepTangent::extra_gaps(const DenseStepRecord::Place& place) {
  VecX gaps = VecX::Zero(rows_);
  twists_.place(place.q);
  for (std::size_t i = 0; i < is_found_.size(); ++i)
    if (is_found_[i] != 0) gaps[record_->contacts[i].row] = extra_gap(i, place.end[i]).gap;
  return gaps;
}

DenseStepTangent::Extra DenseStepTangent::extra(std::size_t i, const Site& site, const Contact& at, const Vec3& t1,
                                                Eigen::Ref<MatX> dW) {
  const ContactPoint& law = record_->contacts[i].law;
  Extra found = extra_gap(i, at);
  const Vec3 &n = at.normal, &dn = found.normal, t2 = n.cross(t1);
  const Vec3 outward = law.on_b ? n : Vec3(-n), turned = law.on_b ? dn : Vec3(-dn);
  const Vec3 moved = pose_of(law.point_body, twists_.placements()).R * law_change_[i].center - law.radius * turned;
  const Vec3 across = moved - found.gap * outward - at.gap * turned;
  const Vec3 &dx_a = law.on_b ? across : moved, &dx_b = law.on_b ? moved : across;
  const double about = site.contact.turn_by_normal(t1, dn);
  const Eigen::Vector2d shares = site.contact.shares();
  const Vec3 none = Vec3::Zero(), dt[2] = {about * t2 - dn.dot(t1) * n, dn.cross(t1) - about * t1};
  const Vec3 rows[3] = {n, shares[0] * t1, shares[1] * t2}, changes[3] = {dn, shares[0] * dt[0], shares[1] * dt[1]};
  if (site.surface.moves()) found.own = site.surface.change(twists_, {dx_a, dx_b}, dt, dn);
  for (int k = 0; k < static_cast<int>(dW.cols()); ++k) {
    twists_.add_wrench(at.body_b, at.point_b, dx_b, rows[k], changes[k], none, none, dW.col(k));
    twists_.add_wrench(at.body_a, at.point_a, dx_a, -rows[k], -changes[k], none, none, dW.col(k));
  }
  return found;
}

void DenseStepTangent::set_end_rows(const VecX& dq1, double dt) {
  const DenseStepRecord& s = *record_;
  dW1_.setZero();
  down1_.setZero();
  if (constraints_ > 0) end_constraints_.change(dq1, dt, dW1_.leftCols(constraints_));
  twists_.place(s.places.back().q);
  twists_.move(none_);
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const DenseStepRecord::Contact& c = s.contacts[i];
    if (!c.closed && c.pull[1] == 0.0) continue;
    auto dW = dW1_.middleCols(c.row, c.mu > 0.0 ? 3 : 1);
    auto& [contact, surface] = end_[i];
    contact.change(dq1, c.t1_end, dW);
    if (surface.moves()) down1_.segment<2>(c.row + 1) = surface.change(contact) + dt * surface.rate();
    if (is_found_[i] == 0) continue;
    const Extra more = extra(i, end_[i], c.end, c.t1_end, dW);
    if (c.mu > 0.0) down1_.segment<2>(c.row + 1) += more.own;
  }
}

// Of the slips of lasting contacts, half the difference between both ends, at a place that changes so; after
// set_start_rows. dt_end: of the time at the end.
void DenseStepTangent::slip_change(int k, const VecX& dq, const VecX& dv, double dt_end, VecX& dslip) {
  const DenseStepRecord& s = *record_;
  const DenseStepRecord::Place& place = s.places[k];
  MatX dW(scene_->tree.nv, 3);
  dslip.setZero(rows_);
  twists_.place(place.q);
  twists_.move(none_);
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const DenseStepRecord::Contact& c = s.contacts[i];
    if (c.mu == 0.0) continue;
    auto& [contact, surface] = slip_[k][i];
    contact.change(dq, place.t1[i], dW);
    const Vec3 &n0 = c.start.normal, &n1 = place.end[i].normal, &t = c.t1_start, &dn0 = dn0_[i];
    Vec3 dn1 = contact.normal_change();
    Eigen::Vector2d down = Eigen::Vector2d::Zero();
    if (surface.moves()) down = surface.change(contact) + dt_end * surface.rate();
    if (is_found_[i] != 0) {
      const Extra more = extra(i, slip_[k][i], place.end[i], place.t1[i], dW);
      dn1 += more.normal;
      down += more.own;
    }
    // t1 = t - (t.n1) / (1 + n0.n1) (n0 + n1), the shortest turn.
    const double length = 1.0 + n0.dot(n1), share = t.dot(n1) / length;
    const double dshare = (dt1_[i].dot(n1) + t.dot(dn1) - share * (dn0.dot(n1) + n0.dot(dn1))) / length;
    const Vec3 dt1 = dt1_[i] - dshare * (n0 + n1) - share * (dn0 + dn1);
    const double about = contact.has_axis() ? 0.0 : n1.cross(place.t1[i]).dot(dt1);
    const int r = c.row;
    down += about * Eigen::Vector2d(slip_own_[k][r + 2], -slip_own_[k][r + 1]);
    dW.col(1) += about * place.W.col(r + 2);
    dW.col(2) -= about * place.W.col(r + 1);
    for (int j = 1; j < 3; ++j)
      dslip[r + j] = 0.5 * ((dW.col(j) - dW0_.col(r + j)).dot(place.v) +
                            (place.W.col(r + j) - s.W0.col(r + j)).dot(dv) + down[j - 1] - down0_[r + j]);
  }
}

// After set_start_rows and, of the points that they belong to, add_found_rows.
void DenseStepTangent::coefficient_changes(const DenseStepDirection& d) {
  const DenseStepRecord& s = *record_;
  const auto contacts = static_cast<Eigen::Index>(s.contacts.size());
  dmu_.setZero(contacts);
  de_.setZero(contacts);
  for (Eigen::Index i = 0; i < contacts; ++i) {
    const Coefficients& c = coefficients_[static_cast<std::size_t>(i)];
    const int r = s.contacts[static_cast<std::size_t>(i)].row;
    if (c.own_mu && d.mu.size() > 0) dmu_[i] = d.mu[i];
    if (c.own_e && d.e.size() > 0) de_[i] = d.e[i];
    if (c.e_by_closing != 0.0) de_[i] += c.e_by_closing * (dW0_.col(r).dot(v0_) + s.W0.col(r).dot(dv0_));
    de_[i] += c.e_by_time * d.t;
    if (c.mu_by_slip.isZero(0.0) && c.e_by_slip.isZero(0.0) && std::isinf(c.without_rest)) continue;
    const Eigen::Vector2d dslip = dW0_.middleCols<2>(r + 1).transpose() * v0_ +
                                  s.W0.middleCols<2>(r + 1).transpose() * dv0_ + down0_.segment<2>(r + 1);
    dmu_[i] += c.mu_by_slip.dot(dslip);
    de_[i] += c.e_by_slip.dot(dslip);
    if (!std::isinf(c.without_rest)) check_rest(d, static_cast<std::size_t>(i), dslip);
  }
}

// Where a direction moves a contact at the start of the step that holds by its friction of rest alone, that is gone.
void DenseStepTangent::check_rest(const DenseStepDirection& d, std::size_t i, const Eigen::Vector2d& slip_change) {
  const DenseStepRecord& s = *record_;
  const int r = s.contacts[i].row;
  const double change = dv0_.cwiseAbs().maxCoeff() + d.size_q * v0_.cwiseAbs().maxCoeff();
  if (!(slip_change.norm() > kShared * change * s.W0.middleCols<2>(r + 1).cwiseAbs().maxCoeff())) return;
  const double mu = coefficients_[i].without_rest;
  const auto holds = [&](const VecX& lambda) {
    return lambda.segment<2>(r + 1).norm() > mu * lambda[r] * (1.0 + kOnCone);
  };
  bool any = holds(s.plastic);
  for (const DenseStepRecord::Round& round : s.rounds) any |= holds(round.lambda);
  if (any) approximate("friction of rest that a direction takes away");
}

// dD u of a round.
void DenseStepTangent::matrix_change(const Round& round, const DenseStepDirection& d, const VecX& dq0, const VecX& u,
                                     VecX& change) {
  const double h = record_->h;
  const int n = scene_->tree.nv;
  change = round.mass_effect.leftCols(n) * dq0 + round.mass_effect.middleCols(n, n) * dv0_ +
           round.mass_effect.middleCols(2 * n, n) * places_[0].v + round.mass_effect.col(3 * n) * d.h;
  if (d.parameters == nullptr) return;
  const StepParameters& p = *d.parameters;
  const VecX others = change;
  free_.add_momentum(q_stage_, u, p, change);
  change += 0.5 * h * (p.damping + p.kd).cwiseProduct(u) + 0.25 * h * h * p.kp.cwiseProduct(u);
  for (std::size_t k = 0; k < scene_->tree.joints.size(); ++k) {
    const Joint& joint = scene_->tree.joints[k];
    change.segment(joint.iv, joint.nv) +=
        0.25 * h * h * p.stiffness[static_cast<Eigen::Index>(k)] * u.segment(joint.iv, joint.nv);
  }
  // That is the change of one matrix. The factor of D is made at one configuration and applied at another one.
  const VecX turned = round.mass_effect.middleCols(2 * n, n) * (record_->places[0].v - v0_);
  if (change != others && turned.norm() > kOneMatrix * (record_->D * u).norm())
    approximate("parameters of inertias and joints in masses that change within the step");
}

double DenseStepTangent::allowed_change(const DenseStepRecord::Contact& c, const VecX& dq0, double dh) const {
  if (!(c.allowed < 0.0)) return 0.0;
  return record_->W0.col(c.row).dot(dq0) + record_->allowed_rate * dh;
}

void DenseStepTangent::solve_laws(const DenseLaws& laws, const VecX& base, const VecX& known, const VecX& mu,
                                  const VecX& size, VecX& dlambda) const {
  if (laws.solve(base, known, mu, size, dlambda) || kinks_->taken()) return;
  refuse("redundant", -1, "Contact points that share their load contradict each other along a direction",
         "a direction that keeps the points of a face closed together", "one that opens some of them",
         "Start with the bodies apart, or use on_kink='taken' for the derivative with impulses of least norm");
}

// The sizes of the terms of the rows' changes.
VecX DenseStepTangent::sizes(const DenseStepDirection& d) const {
  double size_q = std::max(d.size_q, 0.0), size_p = std::max({d.size_p, dp_.cwiseAbs().maxCoeff()});
  for (const Change& change : places_)
    if (change.q.size() > 0) size_q = std::max(size_q, change.q.cwiseAbs().maxCoeff());
  if (d.q.size() > 0) size_q = std::max(size_q, d.q.cwiseAbs().maxCoeff());
  return (size_q / record_->h * record_->W1.cwiseAbs() + size_p * MinvW_.cwiseAbs() + size_p * DinvW_.cwiseAbs())
      .colwise()
      .sum();
}

// known: with the changes of friction in its rows; fills the bounds of the normal impulses that it asks for.
void DenseStepTangent::low_changes(const Round& round, const VecX& mu, VecX& known) const {
  const std::vector<DenseLaws::Contact>& gaps = round.gaps.contacts();
  for (std::size_t i = 0; i < gaps.size(); ++i) {
    const DenseLaws::Contact& c = gaps[i];
    const int r = c.row;
    known[r] = 0.0;
    if (c.normal != DenseLaws::Normal::kBound || c.mu == 0.0) continue;
    const Eigen::Vector2d t = round.lambda.segment<2>(r + 1);
    const double size = t.norm(), dmu = mu.size() > 0 ? mu[static_cast<Eigen::Index>(i)] : 0.0;
    if (size > 0.0) known[r] = t.dot(known.segment<2>(r + 1)) / (size * c.mu) - size / (c.mu * c.mu) * dmu;
  }
}

// A sliding contact whose gap is closed by just the normal impulse that its friction asks for: to one side the gap
// iterations close it, to the other friction holds it open. That is a kink where both are not the same.
void DenseStepTangent::check_held_gaps(const Round& round, const DenseStepDirection& d, const VecX& dlaw,
                                       const VecX& dlambda) {
  VecX apart = VecX::Zero(rows_);
  const VecX speeds = sizes(d);
  double size = std::max(d.size_p, dp_.cwiseAbs().maxCoeff());
  for (std::size_t i = 0; i < round.gaps.contacts().size(); ++i) {
    const DenseLaws::Contact& c = round.gaps.contacts()[i];
    if (c.normal != DenseLaws::Normal::kClosed || round.law.contacts()[i].friction != DenseLaws::Friction::kSlip)
      continue;
    const Eigen::Vector2d t = round.lambda.segment<2>(c.row + 1);
    const double friction = t.norm(), normal = round.lambda[c.row];
    if (!(friction > 0.0) || normal - friction / c.mu > kOnCone * normal) continue;
    const double dmu = dmu_[static_cast<Eigen::Index>(i)];
    const double low = t.dot(dlaw.segment<2>(c.row + 1)) / (friction * c.mu) - friction / (c.mu * c.mu) * dmu;
    apart[c.row] = dlambda[c.row] - low;
    // What rounding of the speeds of the gap moves.
    const double mobility = record_->W0.col(c.row).dot(DinvW_.col(c.row));
    size = std::max(size, speeds[c.row] / mobility * round.P.col(c.row).cwiseAbs().maxCoeff());
  }
  if ((round.P * apart).cwiseAbs().maxCoeff() > kShared * size)
    approximate("a sliding contact whose gap stays closed to one side and is held open to the other");
}

// What the residuals of the constraints at a place change by with its time.
VecX DenseStepTangent::end_times(std::size_t place, const DenseStepDirection& d) const {
  return end_rates_[place] * (d.t + d.h);
}

// The first place.
void DenseStepTangent::solve_free(const DenseStepDirection& d, const VecX& dq0) {
  const DenseStepRecord& s = *record_;
  Change& free = places_[0];
  free.q.resize(scene_->tree.nv);
  free.v.resize(scene_->tree.nv);
  free.lambda.setZero(rows_);
  StepDirection direction;
  direction.q = dq0;
  direction.p = d.p.size() > 0 ? d.p : none_;
  if (constraints_ > 0) direction.p += dW0_.leftCols(constraints_) * s.places[0].lambda.head(constraints_);
  direction.t = d.t;
  direction.h = d.h;
  direction.tau = d.tau;
  direction.parameters = d.parameters;
  if (!free_.solve(direction, free.q, dp_))
    refuse("step", -1, "The derivative of a step was not solved", "tangent equations with a solution", "none",
           "Use a smaller dt");
  free_.velocity_change(0, free.v);
  if (constraints_ == 0) return;
  const VecX base = (s.places[0].W.leftCols(constraints_).transpose() * free.q + end_times(0, d)) / s.h;
  VecX dmu;
  free_constraints_.system.solve(base, VecX::Zero(constraints_), dmu);
  free.lambda.head(constraints_) = dmu;
  free.q += free_constraints_.Q * dmu;
  free.v += free_constraints_.V * dmu;
}

void DenseStepTangent::solve_round(std::size_t k, const DenseStepDirection& d, const VecX& dq0) {
  const DenseStepRecord& s = *record_;
  const DenseStepRecord::Round& r = s.rounds[k];
  Round& round = rounds_[k];
  const DenseStepRecord::Place& about = s.places[r.about];
  add_found_rows(r.about, places_[r.about].q);
  coefficient_changes(d);
  const Change &about_change = places_[r.about], &from_change = places_[r.anew ? 0 : r.about];
  const VecX none = VecX::Zero(rows_);
  const VecX& from_lambda = r.anew ? none : about.lambda;
  const VecX &from_v = s.places[r.anew ? 0 : r.about].v, &from_dlambda = r.anew ? none : from_change.lambda;
  // The law. Without friction the gap iterations find all impulses anew.
  VecX base, known = none, dlambda = none;
  if (has_friction_) {
    VecX change, dslip;
    matrix_change(round, d, dq0, r.v - from_v, change);
    VecX force = dW0_ * (r.lambda - from_lambda) - s.W0 * from_dlambda - change;
    if (r.anew) force -= dW0_ * pull0_ + s.W0 * pull_change(false, d);
    project_rows(scene_->tree, force);
    const VecX dv = from_change.v + D_.solve(force);
    base = dW0_.transpose() * r.v + s.W0.transpose() * dv + down0_;
    base += extra_gaps(about) / s.h;
    if (constraints_ > 0)
      base.head(constraints_) -=
          dW0_.leftCols(constraints_).transpose() * from_v + s.W0.leftCols(constraints_).transpose() * from_change.v;
    bool lasting = false;
    for (char c : r.lasting) lasting |= c != 0;
    if (lasting) slip_change(r.slips, places_[r.slips].q, places_[r.slips].v, d.t + d.h, dslip);
    for (std::size_t i = 0; i < s.contacts.size(); ++i) {
      const DenseStepRecord::Contact& c = s.contacts[i];
      const int n = c.row;
      const double gap = about.end[i].gap - c.allowed;
      base[n] += (about.W.col(n).dot(about_change.q) - allowed_change(c, dq0, d.h) - gap / s.h * d.h) / s.h -
                 dW0_.col(n).dot(about.v) - s.W0.col(n).dot(about_change.v);
      if (r.lasting[i] != 0) base.segment<2>(n + 1) += dslip.segment<2>(n + 1);
    }
    for (std::size_t j = 0; j < s.joints.size(); ++j) known[s.row_of(j)] = 0.5 * s.joints[j].limit * d.h;
    solve_laws(round.law, base, known, dmu_, sizes(d), dlambda);
  }
  // The gap iterations.
  Change& next = places_[k + 1];
  known = dlambda;
  low_changes(round, dmu_, known);
  StepDirection direction;
  direction.q = dq0;
  direction.p = dW0_ * (round.lambda - pull0_) - s.W0 * pull_change(false, d);
  if (d.p.size() > 0) direction.p += d.p;
  direction.t = d.t;
  direction.h = d.h;
  direction.tau = d.tau;
  direction.parameters = d.parameters;
  next.q.resize(scene_->tree.nv);
  next.v.resize(scene_->tree.nv);
  if (!round.step.solve(direction, next.q, dp_))
    refuse("step", -1, "The derivative of a step was not solved", "tangent equations with a solution", "none",
           "Use a smaller dt");
  round.step.velocity_change(0, next.v);
  base = (s.places[k + 1].W.transpose() * next.q + extra_gaps(s.places[k + 1])) / s.h;
  for (const DenseStepRecord::Contact& c : s.contacts) base[c.row] -= allowed_change(c, dq0, d.h) / s.h;
  if (constraints_ > 0) base.head(constraints_) += end_times(k + 1, d) / s.h;
  solve_laws(round.gaps, base, known, VecX(), sizes(d), next.lambda);
  if (has_friction_ && rows_ > 0) check_held_gaps(round, d, dlambda, next.lambda);
  next.q += round.Q * next.lambda;
  next.v += round.V * next.lambda;
  dp_ += round.P * next.lambda;
}

// The change of the speeds of the rows at the end where the velocity impulse stays; force: of the momentum, without
// that of the mass matrix.
VecX DenseStepTangent::end_base(const End& end, const DenseStepDirection& d, const VecX& dq1, const VecX& dp,
                                VecX& force) {
  const VecX& q1 = record_->places.back().q;
  force = dp + dW1_ * (end.lambda - pull1_) - record_->W1 * pull_change(true, d);
  free_.momentum(q1, end.v, dq1, none_, work_);
  if (d.parameters != nullptr) free_.add_momentum(q1, end.v, *d.parameters, work_);
  VecX dv = force - work_;
  masses_.solve_mass(dv);
  VecX base = dW1_.transpose() * end.v + record_->W1.transpose() * dv + down1_;
  if (constraints_ > 0) base.head(constraints_) += end_constraints_.rate_change(dq1, d.t + d.h);
  return base;
}

void DenseStepTangent::solve(const DenseStepDirection& d, VecRef dq1, VecRef dp1) {
  const DenseStepRecord& s = *record_;
  const VecX dq0 = d.q.size() > 0 ? d.q : none_, dp0 = d.p.size() > 0 ? d.p : none_;
  clear_law_changes();
  set_start_rows(dq0, d.t);
  free_.momentum(s.q0, v0_, dq0, none_, work_);
  if (d.parameters != nullptr) free_.add_momentum(s.q0, v0_, *d.parameters, work_);
  dv0_ = dp0 - work_;
  start_masses_.place_node(s.q0);
  start_masses_.solve_mass(dv0_);
  places_.assign(s.places.size(), Change());
  solve_free(d, dq0);
  for (std::size_t k = 0; k < s.rounds.size(); ++k) solve_round(k, d, dq0);
  const Change& end = places_.back();
  dq1 = end.q;
  set_end_rows(end.q, d.t + d.h);
  masses_.place_node(s.places.back().q);
  VecX force, known = VecX::Zero(rows_), dplastic, dexpansion, total = s.plastic;
  for (std::size_t j = 0; j < s.joints.size(); ++j) known[s.row_of(j)] = 0.5 * s.joints[j].limit * d.h;
  solve_laws(plastic_.laws, end_base(plastic_, d, end.q, dp_, force), known, dmu_, sizes(d), dplastic);
  VecX dtotal = dplastic;
  double dshare = 0.0;
  if (s.expansion.size() > 0) {
    for (std::size_t j = 0; j < s.joints.size(); ++j) {
      const Eigen::Index r = s.row_of(j);
      known[r] -= std::copysign(1.0, s.plastic[r]) * dplastic[r];
    }
    for (std::size_t i = 0; i < s.contacts.size(); ++i) {
      const DenseStepRecord::Contact& c = s.contacts[i];
      if (!c.expands) continue;
      const double de = de_[static_cast<Eigen::Index>(i)];
      known[c.row] = c.restitution * (end.lambda[c.row] + dplastic[c.row]) + de * (s.lambda[c.row] + s.plastic[c.row]);
    }
    VecX base = end_base(expansion_, d, end.q, dp_, force) + G_ * dplastic;
    solve_laws(expansion_.laws, base, known, dmu_, sizes(d), dexpansion);
    dtotal += s.expanded * dexpansion;
    total += s.expanded * s.expansion;
  }
  dp1 = dp_ + dW1_ * (total - pull1_) + s.W1 * (dtotal - pull_change(true, d));
  if (s.expansion.size() > 0 && s.expanded < 1.0) {
    dshare = (energy_q0_.dot(dq0) + v0_.dot(dp0) - energy_q1_.dot(end.q) - s.v1.dot(dp1)) / expansion_rate_;
    dp1 += dshare * (s.W1 * s.expansion);
  }
}

}  // namespace contactvi

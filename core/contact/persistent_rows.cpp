#include "contact/persistent_rows.hpp"

#include <cmath>

#include "base/tolerances.hpp"
#include "contact/persistent_geometry.hpp"
#include "geometry/line_contact.hpp"

namespace contactvi {

namespace {
constexpr double kSameFriction = 1e-13;  // of coefficients: rounding
}  // namespace

void PersistentRows::set(const std::vector<PersistentContact>& contacts, const std::vector<FrictionJoint>& joints,
                         int places) {
  contacts_ = &contacts;
  joints_ = &joints;
  adheres_ = any_adhesion(guards_->scene(), contacts);
  const std::size_t n = contacts.size();
  rows_.resize(n);
  slide_.assign(n, -1);
  references_.resize(n);
  sliding_.clear();
  slides_.clear();
  by_rate_.clear();
  by_forces_ = false;
  for (std::size_t i = 0; i < n; ++i) {
    const PersistentContact& c = contacts[i];
    rows_[i] = static_cast<int>(by_rate_.size());
    by_rate_.push_back(0);
    if (c.mu == 0.0) continue;
    by_forces_ = by_forces_ || depends_on_force(i);
    if (c.sticks) {
      by_rate_.insert(by_rate_.end(), 2, c.counts_by_place() ? 0 : 1);
    } else {
      slide_[i] = static_cast<int>(slides_.size());
      slides_.push_back({rows_[i], c.mu});
      sliding_.push_back(i);
    }
  }
  joint_rows_.assign(joints.size(), -1);
  loaded_ = false;
  load_.setZero();
  for (std::size_t k = 0; k < joints.size(); ++k) {
    const FrictionJoint& joint = joints[k];
    if (joint.sticks) {
      joint_rows_[k] = static_cast<int>(by_rate_.size());
      by_rate_.push_back(joint.iq >= 0 ? 0 : 1);
    } else {
      load_[joint.dof] = -std::copysign(joint.limit, joint.heading);
      loaded_ = true;
    }
  }
  count_ = static_cast<int>(by_rate_.size());
  sites_.resize(static_cast<std::size_t>(places));
  for (std::vector<Site>& sites : sites_) sites.resize(n);
}

void PersistentRows::place(int place, const VecCRef& q, double t, Placed to) {
  auto& [phi, W, T, rate, drift, pull] = to;
  guards_->place(q);
  std::vector<Site>& sites = sites_[static_cast<std::size_t>(place)];
  for (std::size_t i = 0; i < contacts_->size(); ++i) {
    const PersistentContact& c = (*contacts_)[i];
    Site& site = sites[i];
    geometry_.evaluate(c.point, site.contact);
    const Placements& at = guards_->placements(c.point.guard);
    site.side = Manifolds::side_of_rim(c.point, at);
    site.along = guards_->manifolds().place_along(c.point, at, site.contact);
    Vec3& t1 = site.frame.t1;
    if (place == 0) {
      t1 = geometry_.start_tangent(c, site.contact);
      if (c.counts_by_place()) references_[i] = geometry_.reference(c);
    } else {
      t1 = geometry_.tangent(c, site.contact, sites_[0][i].contact, sites_[0][i].frame.t1);
    }
    site.frame = guards_->frame(c.point.guard, site.contact, t1);
    const int r = rows_[i];
    phi[r] = site.contact.gap;
    if (adheres_) pull[r] = site.pull = adhesion(guards_->scene(), c, t);
    if (c.mu == 0.0) {
      guards_->rows(c.point.guard, site.contact, t1, W.middleCols(r, 1));
      continue;
    }
    guards_->rows(c.point.guard, site.contact, t1, row_of_);
    W.col(r) = row_of_.col(0);
    if (guards_->moves(c.point.guard)) {
      auto own = c.sticks ? rate.segment<2>(r + 1) : drift.segment<2>(2 * slide_[i]);
      own = guards_->surface_velocity(c.point.guard, site.contact, t1, t);
    }
    if (!c.sticks) {
      T.middleCols<2>(2 * slide_[i]) = row_of_.rightCols<2>();
      continue;
    }
    W.middleCols<2>(r + 1) = row_of_.rightCols<2>();
    if (c.counts_by_place())
      phi.segment<2>(r + 1) = geometry_.displacement(c, references_[i]);
    else
      phi.segment<2>(r + 1).setZero();
  }
  for (std::size_t k = 0; k < joints_->size(); ++k) {
    const int r = joint_rows_[k];
    if (r < 0) continue;
    const FrictionJoint& joint = (*joints_)[k];
    W.col(r).setZero();
    W(joint.dof, r) = 1.0;
    phi[r] = joint.iq >= 0 ? q[joint.iq] - joint.anchor : 0.0;
  }
}

bool PersistentRows::friction_varies(int slide) const {
  return guards_->scene().friction_varies((*contacts_)[sliding_[static_cast<std::size_t>(slide)]].point.guard);
}

bool PersistentRows::depends_on_force(std::size_t i) const {
  return guards_->scene().friction_by_state((*contacts_)[i].point.guard);
}

bool PersistentRows::set_friction(const std::vector<SlideState>& slides) const {
  std::vector<FrictionState> states;
  for (const SlideState& s : slides)
    states.push_back({(*contacts_)[sliding_[static_cast<std::size_t>(s.slide)]].point.guard, false, s.speed, s.normal,
                      s.time, *s.mu});
  contactvi::set_friction(guards_->scene(), states);
  double change = 0.0;
  for (std::size_t k = 0; k < slides.size(); ++k) change = FrictionRounds::larger(change, states[k].mu, *slides[k].mu);
  return change > kSameFriction;
}

FrictionState PersistentRows::friction(std::size_t i, double speed, double normal, double t, double mu,
                                       bool derivatives) const {
  const PersistentContact& c = (*contacts_)[i];
  std::vector<FrictionState> one{{c.point.guard, c.sticks, speed, normal, t, mu}};
  contactvi::set_friction(guards_->scene(), one, derivatives);
  return one.front();
}

bool PersistentRows::runs_far(int nodes) const {
  for (std::size_t i = 0; i < contacts_->size(); ++i) {
    const ContactPoint& point = (*contacts_)[i].point;
    for (int k = 1; k < nodes; ++k) {
      const Site &a = site(k - 1, i), &b = site(k, i);
      if (point.kind == PointKind::kRim && a.side.dot(b.side) < kSwing) return true;
      if (guards_->manifolds().run(point, a.along, b.along) > kMostRun) return true;
    }
  }
  return false;
}

double PersistentRows::start_angle(int slide, const Eigen::Vector2d& slip, double speed) const {
  if (slip.norm() > kStill * (1.0 + speed)) return std::atan2(slip[1], slip[0]);
  const std::size_t i = sliding_[static_cast<std::size_t>(slide)];
  const Vec3& heading = (*contacts_)[i].heading;
  const Eigen::Vector2d along = sites_[0][i].frame.rows(heading);
  return std::atan2(along[1], along[0]);
}

}  // namespace contactvi

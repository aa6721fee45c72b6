#include "contact/dense_candidates.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {
constexpr double kLimitPromised = 5e-11;  // [m; rad] of joint limits, which are exact
constexpr double kLimitJoins = 1e-11;     // [m; rad] overlap of limits from which points that became near take part
constexpr double kSamePoint = 1e-7;       // [m] points of one feature nearer to each other are one
constexpr double kOpen = 0.25;            // of its motion: a gap that is wider without impulses hardly closes by them
constexpr double kAnyTurn = 2.0;          // above the sine of any angle: a crossing of edges becomes a plane
}  // namespace

Vec3 DenseContact::turning_W(const Vec3& turning, bool at_end) const {
  const Vec3 &n = at_end ? at1.normal : at0.normal, &t = at_end ? t1_1 : t1_0;
  return turning[0] * n + turning[1] * t + turning[2] * n.cross(t);
}

Vec3 DenseContact::position_W() const { return position[0] * at0.normal + frame(false).force(position.tail<2>()); }

Vec3 DenseContact::velocity_W() const { return velocity[0] * at1.normal + frame(true).force(velocity.tail<2>()); }

void DenseCandidates::begin(const VecCRef& q0, double h, double nominal_h) {
  q0_ = q0;
  h_ = h;
  share_ = h < nominal_h ? h / nominal_h : 1.0;
  near_.clear();
  contacts_.clear();
  passes_ = false;
}

void DenseCandidates::collect(const VecX& bound, const VecX& q_free, const std::vector<DenseImpulse>& impulses) {
  guards_->bound_motion(q0_, bound, h_);
  guards_->place(q0_);
  guards_to_look_at_.clear();
  for (const BroadPhase::NearPair& pair : guards_->near_pairs()) guards_to_look_at_.push_back(pair.guard);
  for (int g = static_cast<int>(scene_->pairs.size()); g < guards_->count(); ++g) guards_to_look_at_.push_back(g);
  const std::size_t known = near_.size();
  for (int g : guards_to_look_at_) {
    const auto last = near_.begin() + static_cast<std::ptrdiff_t>(known);
    if (std::any_of(near_.begin(), last, [g](const Near& near) { return near.guard == g; })) continue;
    if (!guards_->stays_apart(g)) near_.push_back({g, 0.0, guards_->motion(g), allowed(0.0), {}, false});
  }
  guards_->place(q_free);
  for (std::size_t k = known; k < near_.size(); ++k) near_[k].watched = stays_open(near_[k].guard, impulses);
  guards_->place(q0_);
  const auto far = [this](Near& near) { return !near.watched && !is_near(near); };
  near_.erase(std::remove_if(near_.begin() + static_cast<std::ptrdiff_t>(known), near_.end(), far), near_.end());
  for (std::size_t k = known; k < near_.size(); ++k)
    if (!near_[k].watched) add_points(near_[k], impulses);
}

// Whether a pair that is not loaded is so far open where the guards are placed, at the end of the step without
// impulses, that impulses of others will hardly close it. One that adheres may be held by itself.
bool DenseCandidates::stays_open(int guard, const std::vector<DenseImpulse>& impulses) {
  if (!scene_->is_pair(guard)) return false;
  if (const ContactLaw* law = scene_->law(guard); law != nullptr && law->adheres()) return false;
  const auto of_guard = [guard](const DenseImpulse& impulse) { return impulse.guard == guard; };
  if (std::any_of(impulses.begin(), impulses.end(), of_guard)) return false;
  const double open = kOpen * guards_->motion(guard);
  return guards_->distance_bound(guard, open) > open;
}

// An overlap at the start goes no faster than a body falls in the step: pushed out at once it would become a speed. One
// of rounding goes in a nominal step, and in a part of that by its share.
double DenseCandidates::allowed(double gap0) const {
  return std::min(0.0, gap0 + 0.5 * scene_->tree.gravity.norm() * h_ * h_ + kGapPromised * share_);
}

double DenseCandidates::allowed_rate() const {
  return scene_->tree.gravity.norm() * h_ + (share_ < 1.0 ? kGapPromised * share_ / h_ : 0.0);
}

// Where the guards are placed at the start of the step.
bool DenseCandidates::is_near(Near& near) {
  near.gap0 = guards_->evaluate_witness(near.guard, near.witness0);
  near.allowed = allowed(near.gap0);
  return near.gap0 <= near.reach;
}

// The points of a pair at the start of the step, where the guards are placed.
void DenseCandidates::add_points(const Near& near, const std::vector<DenseImpulse>& impulses) {
  points_.clear();
  if (!scene_->is_pair(near.guard)) {
    ContactPoint limit{};
    limit.guard = near.guard;
    limit.kind = PointKind::kLimit;
    points_.push_back(limit);
  } else {
    const double margin = std::max(near.gap0, 0.0) + near.reach;
    guards_->manifolds().find(near.guard, guards_->placements(), near.witness0, margin, points_);
  }
  // Where a neighbour of the shape reaches beyond a point, its plane is none of what the body meets on its way.
  const Seams& seams = guards_->manifolds().seams();
  const bool any_seams = scene_->is_pair(near.guard) && seams.any(near.guard);
  for (const ContactPoint& point : points_) {
    Contact contact;
    if (any_seams) evaluate(point, &near.witness0, contact);
    if (any_seams && seams.slack(near.guard, guards_->placements(), contact) >= kFeatureRounding) continue;
    add(point, frozen(point, near.witness0), near, impulses);
  }
  if (!scene_->is_pair(near.guard)) return;
  add_loaded(near, impulses);
  add_rims(near, impulses);
  add_ends(near, impulses);
}

// Corners that carried something in the last step, where others span a larger area: without them the step would be
// solved twice.
void DenseCandidates::add_loaded(const Near& near, const std::vector<DenseImpulse>& impulses) {
  Manifolds& manifolds = guards_->manifolds();
  for (const DenseImpulse& impulse : impulses) {
    const Feature kind = feature_kind(impulse.feature);
    if (impulse.guard != near.guard || (kind != Feature::kVertexA && kind != Feature::kVertexB)) continue;
    const ContactPoint point = manifolds.point(near.guard, guards_->placements(), near.witness0, impulse.feature);
    Contact contact;
    evaluate(point, nullptr, contact);
    if (contact.gap <= std::max(near.gap0, 0.0) + near.reach && manifolds.is_over_face(point, guards_->placements()))
      add(point, point, near, impulses);
  }
}

// Lines that are nearly parallel may touch at either end within the step.
void DenseCandidates::add_ends(const Near& near, const std::vector<DenseImpulse>& impulses) {
  points_.clear();
  guards_->manifolds().find_ends(near.guard, guards_->placements(), std::max(near.gap0, 0.0) + near.reach, points_);
  for (const ContactPoint& end : points_) {
    const bool known = std::any_of(contacts_.begin(), contacts_.end(), [&](const DenseContact& c) {
      return c.point.guard == near.guard && c.law.kind == PointKind::kEnd && c.law.on_b == end.on_b &&
             (c.law.center_B - end.center_B).squaredNorm() < kSamePoint * kSamePoint;
    });
    if (!known) add(end, end, near, impulses);
  }
}

// A rim that is nearly flat may touch all around within the step: material points at its quarters join the lowest one.
void DenseCandidates::add_rims(const Near& near, const std::vector<DenseImpulse>& impulses) {
  Manifolds& manifolds = guards_->manifolds();
  for (std::size_t k = 0, count = points_.size(); k < count; ++k) {
    if (points_[k].kind != PointKind::kRim) continue;
    for (int quarter = 0; quarter < 4; ++quarter) {
      const std::int64_t feature = rim_quarter(points_[k].feature, quarter);
      const ContactPoint point = manifolds.point(near.guard, guards_->placements(), near.witness0, feature);
      Contact contact;
      evaluate(point, contact);
      if (contact.gap <= std::max(near.gap0, 0.0) + near.reach && manifolds.is_over_face(point, guards_->placements()))
        add(point, point, near, impulses);
    }
  }
}

void DenseCandidates::evaluate(const ContactPoint& point, const Contact* witness, Contact& contact) {
  if (point.kind != PointKind::kWitness && point.kind != PointKind::kLimit)
    guards_->manifolds().evaluate(point, guards_->placements(), contact);
  else if (witness != nullptr)
    contact = *witness;
  else
    guards_->evaluate_witness(point.guard, contact);
}

// A point joins the candidates, unless it is one of them. The guards are placed at the start of the step.
bool DenseCandidates::add(const ContactPoint& point, const ContactPoint& law, const Near& near,
                          const std::vector<DenseImpulse>& impulses, bool joined) {
  for (const DenseContact& c : contacts_)
    if (c.point.guard == point.guard && c.point.feature == point.feature &&
        (c.law.center_B - law.center_B).squaredNorm() < kSamePoint * kSamePoint)
      return false;
  DenseContact c{};
  for (Vec3* x : {&c.position, &c.velocity, &c.position_turning, &c.velocity_turning, &c.turning_speed}) x->setZero();
  for (Vec3* x : {&c.turning_drift0, &c.turning_drift1}) x->setZero();
  c.pull.setZero();
  c.point = point;
  c.joined = joined;
  c.mu = scene_->friction(point.guard);
  c.shares = guards_->has_axis(point.guard) ? scene_->law(point.guard)->shares : Eigen::Vector2d(1.0, 1.0);
  c.restitution = scene_->restitution(point.guard);
  if (const ContactLaw* law = scene_->law(point.guard); law != nullptr && c.mu > 0.0) {
    c.spinning = law->spinning;
    c.rolling = law->rolling;
  }
  set_law(c, law, near);
  set_start_impulses(c, impulses);
  contacts_.push_back(c);
  return true;
}

void DenseCandidates::set_law(DenseContact& c, const ContactPoint& law, const Near& near) {
  c.law = law;
  evaluate(law, &near.witness0, c.at0);
  c.allowed = std::min(near.allowed, allowed(c.at0.gap));
  c.t1_0 = scene_->is_pair(c.point.guard) ? guards_->tangent(c.point.guard, c.at0.normal) : Vec3(Vec3::Zero());
}

const DenseCandidates::Near& DenseCandidates::near_of(int guard) const {
  return *std::find_if(near_.begin(), near_.end(), [guard](const Near& near) { return near.guard == guard; });
}

// Crossings whose lines overlap at the end of the step, where the guards are placed, beyond the ends of the edges. The
// crossing of edges at a small angle runs along them: its gap follows no motion of a point there, and cannot be closed.
void DenseCandidates::find_run_off(std::size_t known) {
  run_off_.clear();
  for (std::size_t k = 0; k < known; ++k) {
    const DenseContact& c = contacts_[k];
    if (c.law.kind != PointKind::kEdge || !(c.at1.gap < c.allowed - kGapPromised)) continue;
    if (!guards_->manifolds().valid(c.law, guards_->placements())) run_off_.push_back(k);
  }
}

void DenseCandidates::set_start_impulses(DenseContact& c, const std::vector<DenseImpulse>& impulses) const {
  const auto last = std::find_if(impulses.begin(), impulses.end(), [&](const DenseImpulse& impulse) {
    return impulse.guard == c.point.guard && impulse.feature == c.point.feature;
  });
  if (last == impulses.end()) return;
  const auto along = [&](const Vec3& f) {
    const Eigen::Vector2d tangential = c.frame(false).impulses(f);
    return Vec3(f.dot(c.at0.normal), tangential[0], tangential[1]);
  };
  const bool pair = scene_->is_pair(c.point.guard);
  c.position = h_ * (pair ? along(last->position_force) : last->position_force);
  c.velocity = h_ * (pair ? along(last->velocity_force) : last->velocity_force);
  if (c.turns()) {
    const Vec3 &n = c.at0.normal, &t = c.t1_0;
    const auto about = [&](const Vec3& f) { return Vec3(f.dot(n), f.dot(t), f.dot(n.cross(t))); };
    c.position_turning = h_ * about(last->position_turning);
    c.velocity_turning = h_ * about(last->velocity_turning);
  }
  if (c.rows() == 3) return;
  c.position.tail<2>().setZero();
  c.velocity.tail<2>().setZero();
}

// By the centres of pairs that could pass through each other. Against what has no bounds a gap tells it.
void DenseCandidates::find_passages(const VecX& q1) {
  passes_ = false;
  std::vector<int> fast;
  for (const Near& near : near_) {
    if (near.reach <= 4.0 * thinnest_ || !scene_->is_pair(near.guard)) continue;
    const Geometry &a = scene_->geometries[scene_->pairs[near.guard].a],
                   &b = scene_->geometries[scene_->pairs[near.guard].b];
    if (a.unbounded || b.unbounded) continue;
    if (near.reach > 2.0 * (a.box_half.minCoeff() + b.box_half.minCoeff())) fast.push_back(near.guard);
  }
  const auto between = [this](int guard) -> Vec3 {
    const Placements& at = guards_->placements(guard);
    const auto center = [&at](const Geometry& g) {
      return g.body < 0 ? g.center_B : Vec3(at.p_W[g.body] + at.R_W[g.body] * g.center_B);
    };
    const Pair& pair = scene_->pairs[guard];
    return center(scene_->geometries[pair.b]) - center(scene_->geometries[pair.a]);
  };
  for (int guard : fast) {
    guards_->place(q0_);
    const Vec3 before = between(guard);
    guards_->place(q1);
    passes_ |= before.dot(between(guard)) < 0.0;
  }
}

double DenseCandidates::noise(int guard) const {
  return scene_->is_pair(guard) ? std::max(kGapPromised, guards_->depth_tolerance(guard)) : kLimitPromised;
}

bool DenseCandidates::add_overlapping(const VecX& q1, std::size_t known, const std::vector<DenseImpulse>& impulses) {
  points_.clear();
  laws_.clear();
  gap_ = gap_noise_ = excess_ = 0.0;
  deepest_ = -1;
  bool limit_overlaps = false;
  closing_.clear();
  find_passages(q1);
  guards_->place(q1);
  for (const Near& near : near_) {
    if (near.watched && guards_->distance_bound(near.guard, 0.0) > 0.0) continue;
    Contact witness;
    const double gap = guards_->evaluate_witness(near.guard, witness);
    const bool pair = scene_->is_pair(near.guard);
    const double noise = this->noise(near.guard);
    if (gap < gap_) {
      gap_ = gap;
      deepest_ = near.guard;
    }
    const double excess = gap - near.allowed;
    if (excess + 2.0 * noise < excess_ + gap_noise_) {
      excess_ = excess;
      gap_noise_ = 2.0 * noise;
    }
    limit_overlaps |= !pair && excess < -kLimitJoins;
    if (!(excess < -noise) || !pair) continue;
    if (near.watched) {
      closing_.push_back(&near - near_.data());
      continue;
    }
    const std::size_t count = points_.size();
    guards_->manifolds().find(near.guard, guards_->placements(), witness, 0.0, points_);
    for (std::size_t k = count; k < points_.size(); ++k) laws_.push_back(frozen(points_[k], witness));
  }
  // Limits, and points of pairs that became near since the step was solved, are among the contacts already.
  bool added = (limit_overlaps || !points_.empty()) && contacts_.size() > known;
  find_run_off(known);
  guards_->place(q0_);
  for (std::size_t k : run_off_) {
    DenseContact& c = contacts_[k];
    set_law(c, guards_->manifolds().frozen(c.law, guards_->placements(), c.at0, kAnyTurn, 0.0), near_of(c.point.guard));
    added = true;
  }
  for (std::size_t k = 0; k < points_.size(); ++k)
    added |= add(points_[k], laws_[k], near_of(points_[k].guard), impulses, true);
  for (std::ptrdiff_t k : closing_) {
    Near& near = near_[static_cast<std::size_t>(k)];
    near.watched = false;
    is_near(near);
    add_points(near, impulses);
    added = true;
  }
  return added;
}

}  // namespace contactvi

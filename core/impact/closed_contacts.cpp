// ImpactSequence: the contacts that are closed at the instant of an event, with the points and rows of each.
#include <algorithm>
#include <cmath>

#include "impact/sequence.hpp"
#include "model/cylinder_normals.hpp"

namespace contactvi {

namespace {
constexpr double kImmobile = 1e-12;  // of the inverse inertia without constraints: below it constraints hold the point
constexpr double kDriven = 1e-9;     // of the speeds: constraints that close a held point faster are an error

bool is_whole_rim(const ContactPoint& p) {
  return p.kind == PointKind::kRim || (p.kind == PointKind::kSolids && cylinder_part::is_rim(feature_i(p.feature)));
}
}  // namespace

// Makes closed_[count_] a contact of a guard without points.
void ImpactSequence::begin_guard(int guard) {
  if (count_ == static_cast<int>(closed_.size())) closed_.emplace_back();
  ClosedGuard& c = closed_[count_];
  c.guard = guard;
  c.e = scene_->restitution(guard);
  c.mu = scene_->friction(guard);
  c.time = time_;
  const ContactLaw* law = scene_->law(guard);
  c.spinning = law != nullptr ? law->spinning : 0.0;
  c.rolling = law != nullptr ? law->rolling : 0.0;
  c.law = scene_->friction_varies(guard) ? law : nullptr;
  c.impacted = c.persistent = false;
  c.points.clear();
  c.unused.clear();
  c.count = c.chosen = c.rows = 0;
  c.contacts.clear();
  c.t1.clear();
}

// Adds the points of a guard that are closed at q_, with its persistent ones. False if there are none.
bool ImpactSequence::add_guard(int guard, const std::vector<PersistentContact>& persistent, double margin) {
  begin_guard(guard);
  ClosedGuard& c = closed_[count_];
  Contact& witness = c.witness;
  const double gap = guards_->evaluate_witness(guard, witness);
  if (scene_->is_pair(guard)) {
    guards_->manifolds().find(guard, guards_->placements(), witness, std::max(margin, gap), c.points, &c.unused);
  } else {
    ContactPoint limit{};
    limit.guard = guard;
    limit.kind = PointKind::kLimit;
    c.points.push_back(limit);
  }
  c.chosen = static_cast<int>(c.points.size());
  auto is = [](const ContactPoint& a, const ContactPoint& b) { return a.kind == b.kind && a.feature == b.feature; };
  for (const PersistentContact& h : persistent) {
    if (h.point.guard != guard) continue;
    c.persistent = true;
    bool found = false;
    // The material points of a flat rim represent the rim.
    for (const ContactPoint& p : c.points)
      found |= is(p, h.point) || (is_whole_rim(h.point) && !is_whole_rim(p) && feature_rim(h.point.feature) >= 0 &&
                                  feature_rim(p.feature) == feature_rim(h.point.feature) &&
                                  feature_on_b(p.feature) == feature_on_b(h.point.feature));
    if (found) continue;
    c.points.push_back(h.point);
    for (std::size_t k = c.unused.size(); k-- > 0;)
      if (is(c.unused[k], h.point)) c.unused.erase(c.unused.begin() + static_cast<std::ptrdiff_t>(k));
  }
  if (c.points.empty()) return false;
  for (int i = 0; i < static_cast<int>(c.points.size()); ++i) add_rows(c);
  any_persistent_ |= c.persistent;
  ++count_;
  return true;
}

// Adds the rows of the next point of a guard.
void ImpactSequence::add_rows(ClosedGuard& c) {
  const ContactPoint& point = c.points[c.count];
  const int m = c.rows_per_point(), nv = scene_->tree.nv, total = m * static_cast<int>(c.points.size());
  if (c.W.rows() != nv || c.W.cols() < total) {
    c.W.conservativeResize(nv, total);
    c.MinvW.conservativeResize(nv, total);
    c.mu_fixed.conservativeResize(projection_.rate().size(), total);
  }
  if (c.offset.size() < c.W.cols()) c.offset.conservativeResize(c.W.cols());
  Contact contact = c.witness;
  if (point.kind != PointKind::kWitness && point.kind != PointKind::kLimit)
    guards_->manifolds().evaluate(point, guards_->placements(), contact);
  const Vec3 t1 = c.mu > 0.0 ? guards_->tangent(c.guard, contact.normal) : Vec3(Vec3::Zero());
  guards_->rows(c.guard, contact, t1, c.W.middleCols(c.rows, m));
  c.MinvW.middleCols(c.rows, m) = c.W.middleCols(c.rows, m);
  integrator_->solve_masses(c.MinvW.middleCols(c.rows, m));
  c.offset.segment(c.rows, m).setZero();
  if (projection_.any())
    projection_.apply(c.W.middleCols(c.rows, m), c.MinvW.middleCols(c.rows, m), c.mu_fixed.middleCols(c.rows, m),
                      c.offset.segment(c.rows, m));
  if (m >= 3 && guards_->moves(c.guard))
    c.offset.segment<2>(c.rows + 1) += guards_->surface_velocity(c.guard, contact, t1, time_);
  if (m > 3 && guards_->moves(c.guard)) {
    VecX turning(m - 3);
    guards_->surface_turning(c.guard, contact, t1, time_, turning);
    c.offset.segment(c.rows + 3, m - 3) += turning;
  }
  c.contacts.push_back(contact);
  c.t1.push_back(t1);
  c.rows += m;
  ++c.count;
}

// When a face tips, unused points of it may close: adds the one that closes fastest. False: none closes.
bool ImpactSequence::add_unused_point(const VecX& p) {
  ClosedGuard* tips = nullptr;
  std::size_t best = 0;
  double most = -kSolved * std::max(speeds_, largest_speed(p));
  bool any = false;
  for (int i = 0; i < count_; ++i) any |= !closed_[i].unused.empty();
  if (!any || !integrator_->node_velocity(q_, p, v_)) return false;
  guards_->place(q_);
  MatX row(scene_->tree.nv, 3);
  for (int i = 0; i < count_; ++i) {
    ClosedGuard& c = closed_[i];
    for (std::size_t k = 0; k < c.unused.size(); ++k) {
      Contact contact;
      guards_->manifolds().evaluate(c.unused[k], guards_->placements(), contact);
      guards_->rows(c.guard, contact, any_tangent(contact.normal), row);
      const double gamma = row.col(0).dot(v_);
      if (gamma >= most) continue;
      most = gamma;
      tips = &c;
      best = k;
    }
  }
  if (tips == nullptr) return false;
  tips->points.push_back(tips->unused[best]);
  tips->unused.erase(tips->unused.begin() + static_cast<std::ptrdiff_t>(best));
  add_rows(*tips);
  return true;
}

// Places the bodies, the mass matrix and the constraints at q and time t [s]; no contact is closed yet.
bool ImpactSequence::place(const VecX& q, const VecX& p, double t) {
  count_ = 0;
  held_.clear();
  any_persistent_ = false;
  q_ = q;
  time_ = t;
  guards_->place(q);
  if (!integrator_->node_velocity(q, p, v_))
    return fail(StatusCode::kNewtonFailed, "the mass matrix is not positive definite", -1);
  if (projection_.any()) projection_.set(*integrator_, guards_->placements(), q, t);
  return true;
}

bool ImpactSequence::collect_given(const VecX& q, const VecX& p, double t, const std::vector<int>& guards,
                                   double margin) {
  if (!place(q, p, t)) return false;
  for (int g : guards)
    if (!add_guard(g, {}, margin)) return fail(StatusCode::kImpactUnsolved, "this contact has no points", g);
  return true;
}

bool ImpactSequence::collect_block(const VecX& q, const VecX& p, const ImpactBlockRecord& block) {
  if (!place(q, p, block.time)) return false;
  for (const ImpactBlockRecord::Member& member : block.members) {
    begin_guard(member.guard);
    ClosedGuard& c = closed_[count_++];
    c.e = member.e;
    guards_->evaluate_witness(member.guard, c.witness);
    c.points = member.points;
    for (std::size_t i = 0; i < c.points.size(); ++i) add_rows(c);
  }
  return true;
}

bool ImpactSequence::collect(const VecX& q, const VecX& p, double t, const std::vector<int>& active, int first,
                             const std::vector<PersistentContact>& persistent) {
  if (!place(q, p, t)) return false;
  std::vector<int> guards(active);
  if (first >= 0) guards.push_back(first);
  for (const PersistentContact& h : persistent) guards.push_back(h.point.guard);
  std::sort(guards.begin(), guards.end());
  guards.erase(std::unique(guards.begin(), guards.end()), guards.end());
  for (int g : guards) {
    const double tolerance = Guards::kTouching;
    bool is_persistent = false;
    for (const PersistentContact& h : persistent) is_persistent |= h.point.guard == g;
    Contact contact;
    if (g != first && !is_persistent && !(guards_->evaluate_witness(g, contact) <= tolerance)) continue;
    if (!add_guard(g, persistent, tolerance) || !projection_.any()) continue;
    if (!drop_held_points(closed_[count_ - 1], p))
      return fail(StatusCode::kConstraint, "what the constraints drive or hold runs into what cannot give way", g);
    if (closed_[count_ - 1].count > 0) continue;
    --count_;
    held_.push_back(g);
  }
  return true;
}

// Takes the points off whose normal speed no impulse can change, since the constraints determine it. False if they
// close one of them.
bool ImpactSequence::drop_held_points(ClosedGuard& c, const VecX& p) {
  const int m = c.rows_per_point();
  const double closing = -kDriven * (1.0 + v_.cwiseAbs().maxCoeff());
  int kept = 0, held_chosen = 0;
  for (int i = 0; i < c.count; ++i) {
    if (!is_mobile(c, i)) {
      if (c.gamma_n(i, p) < closing) return false;
      if (i < c.chosen) ++held_chosen;
      continue;
    }
    if (kept < i) {
      c.points[kept] = c.points[i];
      c.contacts[kept] = c.contacts[i];
      c.t1[kept] = c.t1[i];
      c.W.middleCols(m * kept, m) = c.W.middleCols(m * i, m);
      c.MinvW.middleCols(m * kept, m) = c.MinvW.middleCols(m * i, m);
      c.mu_fixed.middleCols(m * kept, m) = c.mu_fixed.middleCols(m * i, m);
      c.offset.segment(m * kept, m) = c.offset.segment(m * i, m);
    }
    ++kept;
  }
  c.points.resize(kept);
  c.contacts.resize(kept);
  c.t1.resize(kept);
  c.count = kept;
  c.chosen -= held_chosen;
  c.rows = m * kept;
  return true;
}

// Whether an impulse at a point of the contact can change its normal speed; otherwise the constraints determine it.
bool ImpactSequence::is_mobile(const ClosedGuard& c, int point) {
  const int r = point * c.rows_per_point();
  // The row without constraints is the projected one plus the part that the projection has taken off.
  const VecX free = c.W.col(r) + projection_.gradients() * c.mu_fixed.col(r);
  VecX answer = free;
  integrator_->solve_mass(answer);
  return c.W.col(r).dot(c.MinvW.col(r)) > kImmobile * free.dot(answer);
}

}  // namespace contactvi

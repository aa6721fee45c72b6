#include "run/contact_set.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {
constexpr double kPersists = 1e-11;  // of the speeds: a closed contact with a slower normal speed persists
// Of kPersists: persistent contacts that separate more slowly are left to the step, and pairs with several points,
// whose gaps differ by more, up to the second number.
constexpr double kSlowSeparation = 1e5, kSlowSeparationOfMany = 2e6;
constexpr double kLetGoTogether = 1e-6;  // of the forces: points of an adhesive pair with less load let go together
constexpr double kUnloaded = 1e-9;       // of the forces: a smaller one is zero
constexpr double kOpenPair = 1e-9;       // [m] beyond this gap of a pair all its points are released
constexpr double kOpenPoint = 1e-12;     // [m] beyond this gap a contact without load is released

// The contact at a point of a guard; null if there is none.
const PersistentContact* find_contact(const std::vector<PersistentContact>& contacts, int guard,
                                      const ContactPoint& point) {
  for (const PersistentContact& c : contacts)
    if (c.point.guard == guard && c.point.kind == point.kind && c.point.feature == point.feature) return &c;
  return nullptr;
}

}  // namespace

void record_change(double time, const ContactPoint& point, Change change, double value, Recording& recording) {
  recording.changes.push_back({time, point.guard, point.feature, change, value});
}

ContactSet::ContactSet(const Scene& scene, RunState& run, Integrator& integrator, Guards& guards, EventFinder& finder,
                       ContactStep& step, ImpactSequence& sequence)
    : scene_(&scene),
      run_(&run),
      integrator_(&integrator),
      guards_(&guards),
      finder_(&finder),
      step_(&step),
      sequence_(&sequence),
      v_(scene.tree.nv) {}

void ContactSet::forget_persistent_guards() {
  for (int g : persistent_guards_) guards_->set_persistent(g, {});
  persistent_guards_.clear();
}

void ContactSet::update_persistent_guards() {
  tell_guards();
  share_adhesion();
  step_->invalidate();
}

void ContactSet::tell_guards() {
  forget_persistent_guards();
  for (const PersistentContact& persistent : step_->contacts()) {
    const int g = persistent.point.guard;
    if (std::find(persistent_guards_.begin(), persistent_guards_.end(), g) != persistent_guards_.end()) continue;
    std::vector<const ContactPoint*> points;
    for (const PersistentContact& other : step_->contacts())
      if (other.point.guard == g) points.push_back(&other.point);
    guards_->set_persistent(g, std::move(points));
    persistent_guards_.push_back(g);
  }
}

// What has let go at some points does not pull more at the others.
void ContactSet::share_adhesion() {
  std::vector<PersistentContact>& contacts = step_->contacts();
  if (!any_adhesion(*scene_, contacts)) return;
  // share(contact, source): its share of what pulls, a pair or a body; null where that does not pull there.
  const auto divide = [&](int source, const auto& share) {
    double points = 0.0, least = 1.0;
    for (PersistentContact& c : contacts)
      if (const double* own = share(c, source)) {
        ++points;
        least = std::min(least, *own);
      }
    for (PersistentContact& c : contacts)
      if (double* own = share(c, source)) *own = std::min(least, 1.0 / points);
  };
  const auto of_pair = [&](PersistentContact& c, int guard) {
    const ContactLaw* law = scene_->law(guard);
    return c.point.guard == guard && law != nullptr && law->pull.given() ? &c.pull_share : nullptr;
  };
  const auto of_body = [&](PersistentContact& c, int body) -> double* {
    const ContactLaw* law = scene_->law(c.point.guard);
    for (int k = 0; k < 2 && law != nullptr; ++k)
      if (law->body_pulls[k] == body) return &c.body_shares[k];
    return nullptr;
  };
  for (const int guard : persistent_guards_) divide(guard, of_pair);
  for (int body = 0; body < static_cast<int>(scene_->body_pulls.size()); ++body) divide(body, of_body);
}

PersistentContact ContactSet::make_persistent(const ContactPoint& point, const Contact& contact, const Vec3& slip) {
  PersistentContact persistent;
  persistent.point = point;
  persistent.mu = scene_->friction(point.guard);
  persistent.by_velocity = guards_->moves(point.guard) || guards_->has_axis(point.guard);
  persistent.tangent = any_tangent(contact.normal);
  if (point.kind == PointKind::kVertex && point.plane_body >= 0)
    persistent.tangent = guards_->placements().R_W[point.plane_body].transpose() * persistent.tangent;
  persistent.slip = slip;
  if (const ContactLaw* law = scene_->law(point.guard); law != nullptr && persistent.mu > 0.0) {
    persistent.spinning = law->spinning;
    persistent.rolling = law->rolling;
  }
  persistent.sticks = slip.norm() <= kPersists * (1.0 + v_.cwiseAbs().maxCoeff());
  step_->set_coefficient(persistent, run_->time);
  return persistent;
}

// Whether point k of a closed guard persists. slow: speed up to which it neither closes nor separates [m/s].
bool ContactSet::persists(const ClosedGuard& c, int k, int forced, double slow) {
  const double gamma = c.gamma_n(k, run_->p);
  const auto separated = std::find_if(run_->separated.begin(), run_->separated.end(), [&](const SeparatedPoint& s) {
    return s.guard == c.guard && s.feature == c.points[k].feature;
  });
  if (separated != run_->separated.end()) {
    if (!c.impacted && c.guard != forced) return false;  // has just separated and has not closed again
    run_->separated.erase(separated);
  }
  double slow_separation = slow * (c.count > 1 ? kSlowSeparationOfMany : c.persistent ? kSlowSeparation : 0.0);
  // Contacts that release each other without progress all persist.
  if (c.persistent && run_->control.stands_still()) slow_separation = INFINITY;
  return !(std::abs(gamma) > slow && c.guard != forced && !(gamma > 0.0 && gamma < slow_separation));
}

// How point k of a closed guard spins and rolls.
void ContactSet::set_turning(const ClosedGuard& c, int k, PersistentContact& persistent) const {
  const int r = c.rows_per_point() * k;
  const double still = kPersists * (1.0 + v_.cwiseAbs().maxCoeff());
  if (persistent.spinning > 0.0) persistent.spin = c.speed(r + 3, run_->p);
  persistent.sticks = std::hypot(persistent.slip.norm(), persistent.spin) <= still;
  if (!(persistent.rolling > 0.0)) return;
  const int roll = r + persistent.rolling_row();
  persistent.roll = c.speed(roll, run_->p) * c.t1[k] + c.speed(roll + 1, run_->p) * c.contacts[k].normal.cross(c.t1[k]);
  if (persistent.roll.norm() <= still) persistent.roll.setZero();
}

// Point k of a closed guard persists; what it was before is kept.
void ContactSet::keep_point(const ClosedGuard& c, int k) {
  Vec3 slip = Vec3::Zero();
  if (c.mu > 0.0) {
    const int r = c.rows_per_point() * k;
    const Eigen::Vector2d w(c.speed(r + 1, run_->p), c.speed(r + 2, run_->p));
    slip = guards_->frame(c.guard, c.contacts[k], c.t1[k]).slip(w);
  }
  PersistentContact persistent = make_persistent(c.points[k], c.contacts[k], slip);
  if (persistent.rows() > 3) set_turning(c, k, persistent);
  const PersistentContact* before = find_contact(previous_, c.guard, c.points[k]);
  if (before != nullptr) {
    persistent.tangent = before->tangent;
    if (persistent.sticks && before->anchored && !c.impacted) {
      persistent.anchored = true;
      persistent.anchor = before->anchor;
    }
  } else {
    persistent.is_new = true;
  }
  step_->contacts().push_back(persistent);
}

// How a point of a dense step spins and rolls at its end.
void ContactSet::take_turning(const DenseContact& c, double h, PersistentContact& persistent) const {
  const double still = kPersists * (1.0 + v_.cwiseAbs().maxCoeff());
  persistent.spin = c.turning_speed[0];
  persistent.sticks = std::hypot(persistent.slip.norm(), persistent.spin) <= still;
  persistent.roll = c.turning_W(Vec3(0.0, c.turning_speed[1], c.turning_speed[2]), true);
  if (persistent.roll.norm() <= still) persistent.roll.setZero();
  const Vec3 force = (c.position_turning + c.velocity_turning) / h;
  persistent.turning_force = persistent.spinning > 0.0 ? force : Vec3(force[1], force[2], 0.0);
}

bool ContactSet::follow(const DenseStep& dense, double time, Recording& recording) {
  guards_->place(dense.end_configuration());
  v_ = dense.end_velocity();
  bool changed = false;
  previous_.swap(step_->contacts());
  std::vector<PersistentContact>& now = step_->contacts();
  now.clear();
  for (const DenseContact& c : dense.contacts()) {
    changed |= c.expands;
    // Several points of one feature, a rim's, persist as one.
    if (!c.loaded() || !c.closed || c.expands || find_contact(now, c.point.guard, c.point) != nullptr) continue;
    PersistentContact persistent = make_persistent(c.point, c.at1, c.slip_W);
    const bool is_vertex = c.point.kind == PointKind::kVertex && c.point.plane_body >= 0;
    persistent.tangent = is_vertex ? Vec3(guards_->placements().R_W[c.point.plane_body].transpose() * c.t1_1) : c.t1_1;
    persistent.force = (c.position + c.velocity) / dense.h();
    if (c.turns()) take_turning(c, dense.h(), persistent);
    if (find_contact(previous_, c.point.guard, c.point) == nullptr) {
      record_change(time, c.point, Change::kBegin, 0.0, recording);
      changed = true;
    }
    now.push_back(persistent);
  }
  for (const PersistentContact& old : previous_) {
    if (find_contact(now, old.point.guard, old.point) != nullptr) continue;
    record_change(time, old.point, Change::kRelease, 0.0, recording);
    changed = true;
  }
  return changed;
}

void ContactSet::close_contacts(int forced, double time, const VecX& tau, Recording& recording) {
  guards_->place(run_->q);
  integrator_->node_velocity(run_->q, run_->p, v_);
  const double slow = kPersists * (1.0 + v_.cwiseAbs().maxCoeff());
  previous_.swap(step_->contacts());
  std::vector<PersistentContact>& now = step_->contacts();
  now.clear();
  for (int i = 0; i < sequence_->count(); ++i) {
    const ClosedGuard& c = sequence_->closed(i);
    bool all = true;
    const std::size_t first_of_guard = now.size();
    for (int k = 0; k < c.count; ++k) {
      if (persists(c, k, forced, slow)) {
        keep_point(c, k);
      } else {
        all = false;
      }
    }
    // If all points of a face persist, those that span it are enough.
    if (all && c.chosen < c.count && c.chosen > 2) now.resize(first_of_guard + c.chosen);
    if (all && c.count > 0) finder_->set_touching(c.guard, false);
  }
  release_unloaded(forced, tau);
  for (const PersistentContact& persistent : now)
    if (persistent.is_new) record_change(time, persistent.point, Change::kBegin, 0.0, recording);
  for (PersistentContact& persistent : now) persistent.is_new = false;
  for (const PersistentContact& old : previous_) {
    bool stays = false;
    for (const PersistentContact& persistent : now)
      stays |= persistent.point.guard == old.point.guard && persistent.point.feature == old.point.feature;
    if (!stays) record_change(time, old.point, Change::kRelease, 0.0, recording);
  }
  update_persistent_guards();
}

// New contacts that no force presses together do not persist: their guards stay touching, and the steps stay smooth.
void ContactSet::release_unloaded(int forced, const VecX& tau) {
  std::vector<PersistentContact>& now = step_->contacts();
  bool any = false;
  for (const PersistentContact& persistent : now) any |= persistent.is_new && persistent.point.guard != forced;
  if (!any) return;
  update_persistent_guards();
  if (!step_->persistent_forces_at(run_->q, run_->p, tau, forces_)) return;
  const double scale = step_->force_scale();
  for (int i = static_cast<int>(now.size()) - 1; i >= 0; --i) {
    if (!now[i].is_new || now[i].point.guard == forced || forces_[i] > kUnloaded * scale) continue;
    finder_->set_touching(now[i].point.guard, true);
    now.erase(now.begin() + i);
  }
}

bool ContactSet::close_contacts_at_start(const std::function<bool(int, int)>& pay) {
  std::vector<int> touching;
  for (int g = 0; g < guards_->count(); ++g)
    if (finder_->touching(g)) touching.push_back(g);
  if (touching.empty() || !sequence_->collect(run_->q, run_->p, run_->time, touching, -1, {})) return true;
  int rows = 0, points = 0;
  for (int i = 0; i < sequence_->count(); ++i) {
    const ClosedGuard& c = sequence_->closed(i);
    points += c.count;
    rows += c.mu > 0.0 ? 3 * c.count : c.count;
  }
  if (!pay(rows, points)) return false;
  Recording start;
  close_contacts(-1, run_->time, VecX(), start);
  run_->initial_changes = start.changes;
  return true;
}

// Which contacts let go with contact i: of an adhesive pair all points that are without load then.
std::vector<char> ContactSet::letting_go(int i, const VecX& tau) {
  const std::vector<PersistentContact>& contacts = step_->contacts();
  std::vector<char> found(contacts.size(), 0);
  if (i < 0) return found;
  found[static_cast<std::size_t>(i)] = 1;
  const int guard = contacts[static_cast<std::size_t>(i)].point.guard;
  const ContactLaw* law = scene_->law(guard);
  if (law == nullptr || !law->adheres()) return found;
  if (!step_->persistent_forces_at(run_->q, run_->p, tau, forces_)) return found;
  const double least = kLetGoTogether * step_->force_scale();
  for (std::size_t k = 0; k < contacts.size(); ++k)
    if (contacts[k].point.guard == guard && forces_[static_cast<Eigen::Index>(k)] <= least) found[k] = 1;
  return found;
}

void ContactSet::release_separated(int releasing, bool at_event, double time, const VecX& tau, Recording& recording) {
  std::vector<PersistentContact>& contacts = step_->contacts();
  std::vector<char> let_go;
  std::vector<ContactOutcome> kept;  // what else lets go is found with other ones
  if (releasing >= 0) {
    kept = step_->outcomes();
    let_go = letting_go(releasing, tau);
  }
  const std::vector<ContactOutcome>& outcomes = releasing >= 0 ? kept : step_->outcomes();
  const double fast = kSeparates * (1.0 + step_->end_velocity().cwiseAbs().maxCoeff());
  bool dropped = false;
  for (int i = static_cast<int>(contacts.size()) - 1; i >= 0; --i) {
    const ContactOutcome& out = outcomes[i];
    const int guard = contacts[i].point.guard;
    const bool goes = releasing >= 0 && let_go[static_cast<std::size_t>(i)] != 0;
    const bool leaves =
        goes || (out.position_impulse[0] <= 0.0 && out.contact.gap > kOpenPoint) || (out.w_n > fast && !at_event);
    if (!leaves) continue;
    const ContactPoint point = contacts[i].point;
    record_change(time, point, Change::kRelease, 0.0, recording);
    contacts.erase(contacts.begin() + i);
    finder_->set_touching(guard, true);
    run_->separated.push_back({guard, point.feature});
    if (goes) finder_->exempt(guard);
    dropped = true;
  }
  if (dropped) update_persistent_guards();
}

void ContactSet::release(int i, double time, const VecX& tau, Recording& recording) {
  const std::vector<char> let_go = letting_go(i, tau);
  const int guard = step_->contacts()[i].point.guard;
  for (std::size_t k = let_go.size(); k-- > 0;) {
    if (let_go[k] == 0) continue;
    const ContactPoint point = step_->contacts()[k].point;
    run_->separated.push_back({guard, point.feature});
    step_->contacts().erase(step_->contacts().begin() + static_cast<std::ptrdiff_t>(k));
    record_change(time, point, Change::kRelease, 0.0, recording);
  }
  update_persistent_guards();
  finder_->set_touching(guard, true);
  if (!guards_->is_persistent(guard)) finder_->exempt(guard);
}

void ContactSet::leave(std::size_t i, const VecX& v, double time, Recording& recording) {
  std::vector<PersistentContact>& contacts = step_->contacts();
  const PersistentContact old = contacts[i];
  const int g = old.point.guard;
  v_ = v;
  run_->separated.push_back({g, old.point.feature, true});
  contacts.erase(contacts.begin() + static_cast<std::ptrdiff_t>(i));
  record_change(time, old.point, Change::kRelease, 0.0, recording);
  tell_guards();
  find_touching(g);
  const double slow = kSlowSeparation * kPersists * (1.0 + v.cwiseAbs().maxCoeff());
  MatX row(scene_->tree.nv, 3);
  for (const ContactPoint& point : points_) {
    if (find_contact(contacts, g, point) != nullptr) continue;
    Contact contact = witness_;
    if (point.kind != PointKind::kWitness) guards_->manifolds().evaluate(point, guards_->placements(), contact);
    const Vec3 t1 = guards_->tangent(g, contact.normal);
    guards_->rows(g, contact, t1, row);
    if (std::abs(row.col(0).dot(v)) > slow) continue;
    Eigen::Vector2d w(row.col(1).dot(v), row.col(2).dot(v));
    if (guards_->moves(g)) w += guards_->surface_velocity(g, contact, t1, time);
    const Vec3 slip = guards_->frame(g, contact, t1).slip(w);
    contacts.push_back(make_persistent(point, contact, old.slides() ? slip : Vec3(Vec3::Zero())));
    record_change(time, point, Change::kBegin, 0.0, recording);
  }
  update_persistent_guards();
}

// Whether the points of a guard have to be found again. Against a halfspace they stay the same while they are valid;
// but a face that has come to lie on three of its corners brings the others down without an impact.
bool ContactSet::points_may_change(int guard) {
  const Pair& pair = scene_->pairs[guard];
  if (!scene_->geometries[pair.a].unbounded && !scene_->geometries[pair.b].unbounded) return true;
  guards_->place(run_->q);
  int count = 0;
  for (const PersistentContact& persistent : step_->contacts()) {
    if (persistent.point.guard != guard) continue;
    ++count;
    if (persistent.point.kind != PointKind::kWitness &&
        !guards_->manifolds().valid(persistent.point, guards_->placements()))
      return true;
  }
  return count > 2 && count < guards_->manifolds().most_points();
}

// Releases all points of a guard.
void ContactSet::release_guard(int guard, double time, Recording& recording) {
  std::vector<PersistentContact>& contacts = step_->contacts();
  for (int i = static_cast<int>(contacts.size()) - 1; i >= 0; --i) {
    if (contacts[i].point.guard != guard) continue;
    record_change(time, contacts[i].point, Change::kRelease, 0.0, recording);
    contacts.erase(contacts.begin() + i);
  }
  finder_->set_touching(guard, false);
  update_persistent_guards();
}

// Of the separated points of a guard those are forgotten that are no longer found; the others are taken out of points_.
void ContactSet::forget_separated(int guard) {
  std::vector<SeparatedPoint>& separated = run_->separated;
  for (std::size_t k = separated.size(); k-- > 0;) {
    const SeparatedPoint& s = separated[k];
    if (s.guard != guard) continue;
    bool near = std::find(left_.begin(), left_.end(), s.feature) != left_.end();
    for (const ContactPoint& p : points_) near |= p.feature == s.feature;
    if (!near) separated.erase(separated.begin() + static_cast<std::ptrdiff_t>(k));
  }
  points_.erase(std::remove_if(points_.begin(), points_.end(),
                               [&](const ContactPoint& p) {
                                 return std::any_of(separated.begin(), separated.end(), [&](const SeparatedPoint& s) {
                                   return s.guard == guard && s.feature == p.feature;
                                 });
                               }),
                points_.end());
}

// Fills points_ with the points of a guard that touch and have not separated, and witness_. False: it has opened.
bool ContactSet::find_touching(int guard) {
  guards_->place(run_->q);
  const double gap = guards_->evaluate_witness(guard, witness_), touch = Guards::kTouching;
  points_.clear();
  if (gap > std::max(touch, kOpenPair)) return false;
  Manifolds& manifolds = guards_->manifolds();
  const Placements& at = guards_->placements();
  left_.clear();
  for (const SeparatedPoint& s : run_->separated) {
    if (s.guard != guard || !s.left) continue;
    const bool back = manifolds.inside_face(manifolds.point(guard, at, witness_, s.feature), at) > kBorder;
    if (!back) left_.push_back(s.feature);
  }
  manifolds.find(guard, at, witness_, std::max(touch, gap) + 1e-12, points_, nullptr, &left_);
  forget_separated(guard);
  return true;
}

// Whether the points of a guard that touch are others than its persistent contacts. A pair that has opened is entered
// in lost_guards_.
bool ContactSet::points_changed(int guard) {
  if (!find_touching(guard)) {
    lost_guards_.push_back(guard);  // its points slid over an edge in the last step
    return false;
  }
  bool same = true;
  int persistent_count = 0;
  for (const PersistentContact& persistent : step_->contacts()) {
    if (persistent.point.guard != guard) continue;
    ++persistent_count;
    bool found = false;
    for (const ContactPoint& p : points_)
      found |= p.kind == persistent.point.kind && p.feature == persistent.point.feature;
    same &= found;
  }
  return !same || persistent_count != static_cast<int>(points_.size());
}

int ContactSet::find_points(double time, Recording& recording) {
  for (PersistentContact& persistent : step_->contacts()) {
    if (!moves_over_both(persistent.point.kind)) continue;
    guards_->place(run_->q);
    guards_->manifolds().update_moving(persistent.point, guards_->placements());
  }
  int changed = -1;
  for (int g : persistent_guards_)
    if (scene_->is_pair(g) && points_may_change(g) && points_changed(g)) changed = g;
  for (int g : lost_guards_) release_guard(g, time, recording);
  lost_guards_.clear();
  return changed;
}

}  // namespace contactvi

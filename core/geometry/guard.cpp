#include "geometry/guard.hpp"

#include <algorithm>
#include <cmath>

#include "geometry/box.hpp"
#include "geometry/other_features.hpp"
#include "model/step_costs.hpp"

namespace contactvi {

namespace {
constexpr double kBehind = 0.1 * Guards::kPromised;  // [m] in front of what touches: that is kept to what is promised
constexpr double kAcross = 1e-9;  // sine of the angle from which on an axis has a direction in a tangent plane
// [m] Boxes that are farther apart hold shapes that do not touch: more than the tolerance of touching and the noise of
// coal's distances (2e-8).
constexpr double kMeeting = 1e-7;
// [m] From this distance on the normal that coal's points of polytopes give is as good as that of their features: their
// rounding of 1e-16 over the distance is 1e-13.
constexpr double kFarApart = 1e-3;
// Reference steps: where the bound on the distance of one pair ends a span sooner, the exact distance is found. That
// costs about as much as a step that looks at guards.
constexpr double kShortSpan = 8.0;
}  // namespace

Guards::Guards(const Scene& scene, int contact_points)
    : scene_(&scene),
      count_(scene.guard_count()),
      pairs_(static_cast<int>(scene.pairs.size())),
      manifolds_(scene, contact_points),
      persistent_number_(count_, -1),
      placements_(scene.tree),
      q_(VecX::Zero(scene.tree.nq)),
      placed_for_(scene.tree.joints.size(), -1),
      distance_bounds_(scene.pairs.size()),
      bounds_(scene),
      motion_(bounds_.none()),
      doubt_(motion_),
      bend_(motion_),
      expected_(motion_),
      odometer_(bounds_.entries()),
      interval_start_(bounds_.entries()),
      gap_(count_),
      gap_for_(count_, -1),
      marks_(count_, -1.0),
      broad_phase_(scene),
      span_(scene.tree.nv) {}

void Guards::place(const VecCRef& q) {
  if ((q.array() == q_.array()).all()) return;
  q_ = q;
  ++configuration_;
}

void Guards::place_body(int body) {
  if (body < 0 || placed_for_[body] == configuration_) return;
  place_body(scene_->tree.joints[body].parent);
  contactvi::place_body(scene_->tree, body, q_, placements_);
  placed_for_[body] = configuration_;
}

void Guards::place_pair(int guard) {
  place_body(scene_->geometries[scene_->pairs[guard].a].body);
  place_body(scene_->geometries[scene_->pairs[guard].b].body);
}

void Guards::place_bodies() {
  if (all_placed_for_ == configuration_) return;
  for (int i = 0; i < static_cast<int>(placed_for_.size()); ++i) place_body(i);
  all_placed_for_ = configuration_;
}

void Guards::restart() {
  keep_start();
  span_.end();
  forget_distances();
  std::fill(odometer_.begin(), odometer_.end(), 0.0);
}

void Guards::forget_distances() {
  end_span();
  distance_bounds_.forget();
  std::fill(marks_.begin(), marks_.end(), -1.0);
  std::fill(motion_.geometry.begin(), motion_.geometry.end(), 0.0);
  broad_phase_.invalidate();
}

const std::vector<BroadPhase::NearPair>& Guards::near_pairs() {
  if (pairs_ > 0 && broad_phase_.is_outdated(odometer_, motion_.geometry, span_ended_)) {
    for (int g : broad_phase_.leaving()) place_body(scene_->geometries[g].body);
    broad_phase_.renew(placements_, odometer_, motion_.geometry);
  }
  return broad_phase_.near_pairs();
}

namespace {

void geometry_pose(const Geometry& g, const Placements& at, Mat3& R, Vec3& p) {
  if (g.body < 0) {
    R = g.R_BG;
    p = g.p_BG;
  } else {
    R.noalias() = at.R_W[g.body] * g.R_BG;
    p = at.p_W[g.body] + at.R_W[g.body] * g.p_BG;
  }
}

// Whether bounds on the distance pay: against a halfspace or a ball it costs hardly more itself.
bool has_bounds(const Geometry& a, const Geometry& b) {
  return !(a.unbounded || b.unbounded || a.is_ball || b.is_ball);
}

Vec3 sphere_center(const Geometry& g, const Placements& at) {
  if (g.body < 0) return g.center_B;
  return at.p_W[g.body] + at.R_W[g.body] * g.center_B;
}

}  // namespace

double Guards::limit_gap(int guard, const VecCRef& q) const {
  const JointLimit& limit = scene_->tree.limits[guard - pairs_];
  const double value = q[scene_->tree.joints[limit.joint].iq];
  return limit.upper ? limit.bound - value : value - limit.bound;
}

void Guards::set_persistent(int guard, std::vector<const ContactPoint*> points) {
  end_span();
  if (manifolds_.any_feet() && guard < pairs_) manifolds_.set_persistent(guard, points);
  int& number = persistent_number_[guard];
  if (number < 0 && free_lists_.empty()) {
    free_lists_.push_back(static_cast<int>(persistent_points_.size()));
    persistent_points_.emplace_back();
  }
  if (number < 0 && !points.empty()) {
    number = free_lists_.back();
    free_lists_.pop_back();
  }
  if (number >= 0 && points.empty()) {
    free_lists_.push_back(number);
    number = -1;
  }
  if (number >= 0) persistent_points_[number] = std::move(points);
  unmark(guard);
}

bool Guards::is_held(int guard) {
  place_pair(guard);
  const std::vector<const ContactPoint*>& points = persistent_points_[persistent_number_[guard]];
  return std::any_of(points.begin(), points.end(), [&](const ContactPoint* point) {
    Contact contact;
    if (point->kind == PointKind::kWitness || point->kind == PointKind::kLimit) return false;
    manifolds_.evaluate(*point, placements_, contact);
    return contact.gap <= promised(guard);
  });
}

void Guards::list_joints(int guard, std::vector<int>& joints) const {
  joints.clear();
  if (guard >= pairs_) {
    joints.push_back(scene_->tree.limits[guard - pairs_].joint);
    return;
  }
  for (int g : {scene_->pairs[guard].a, scene_->pairs[guard].b})
    for (int j = scene_->geometries[g].body; j >= 0; j = scene_->tree.joints[j].parent) joints.push_back(j);
}

void Guards::list_meeting(std::vector<int>& guards) {
  guards.clear();
  for (const BroadPhase::NearPair& pair : near_pairs()) {
    const Geometry &a = scene_->geometries[pair.a], &b = scene_->geometries[pair.b];
    place_pair(pair.guard);
    const double apart = a.unbounded   ? separation(box_of(b, placements_), a, placements_)
                         : b.unbounded ? separation(box_of(a, placements_), b, placements_)
                                       : separation(box_of(a, placements_), box_of(b, placements_));
    if (!(apart > kMeeting)) guards.push_back(pair.guard);
  }
  for (int k = pairs_; k < count_; ++k) guards.push_back(k);
}

double Guards::evaluate(int guard, Contact& contact, double enough) {
  if (persistent_number_[guard] < 0) return evaluate_witness(guard, contact);
  const std::vector<const ContactPoint*>& persistent = persistent_points_[persistent_number_[guard]];
  double gap = kInfinity;
  Contact witness{};
  if (persistent[0]->kind != PointKind::kWitness && persistent[0]->kind != PointKind::kLimit) {
    const auto count = static_cast<int>(persistent.size());
    place_pair(guard);
    const bool bounded = manifolds_.none_deeper(guard, placements_, persistent.data(), count);
    if (bounded) {
      ++counters.evaluated;
      // As much as with coal: what the fitted costs of steps hold, which decide when dense ones are taken.
      counters.cost += costs::near_distance() + (has_closed_form(guard) ? 0.0 : costs::distance());
    } else {
      evaluate_witness(guard, witness);
    }
    contact = witness;
    gap = manifolds_.next_gap(guard, placements_, persistent.data(), count, bounded ? nullptr : &witness, enough,
                              contact);
  }
  if (gap == kInfinity) {
    contact = {kNothingElse, Vec3::Zero(), Vec3::Zero(), Vec3::Zero(), -1, -1};
    return kNothingElse;
  }
  contact.gap = gap;
  return gap;
}

// A shape of a pair where its body is placed.
PosedShape Guards::posed(const Pair& pair, int geometry) const {
  const Geometry& g = scene_->geometries[geometry];
  PosedShape posed{pair.rounded && g.rounded ? g.rounded.get() : g.sharp.get(), {}, {}};
  geometry_pose(g, placements_, posed.R, posed.p);
  return posed;
}

// Of a pair whose bodies are placed.
DistanceBounds::Bounds Guards::known_bounds(int guard) {
  const Pair& pair = scene_->pairs[guard];
  if (!has_bounds(scene_->geometries[pair.a], scene_->geometries[pair.b])) return {-kInfinity, kInfinity};
  return distance_bounds_.find(guard, posed(pair, pair.a), posed(pair, pair.b));
}

double Guards::distance_bound(int guard, double enough) {
  const Pair& pair = scene_->pairs[guard];
  const Geometry &a = scene_->geometries[pair.a], &b = scene_->geometries[pair.b];
  double distance = -kInfinity;
  if (!a.unbounded && !b.unbounded) {
    place_pair(guard);
    const DistanceBounds::Bounds known = known_bounds(guard);
    distance = std::max(separation(box_of(a, placements_), box_of(b, placements_)), known.lower);
    if (DistanceBounds::is_close(known)) return distance;
  }
  if (distance >= enough) return distance;
  Contact contact;
  return std::max(distance, reliable(guard, evaluate_witness(guard, contact)));
}

double Guards::reliable(int guard, double gap) const {
  const Pair& pair = scene_->pairs[guard];
  const Geometry &a = scene_->geometries[pair.a], &b = scene_->geometries[pair.b];
  const FunctionSurface* surface = a.surface ? a.surface.get() : b.surface.get();
  return surface != nullptr ? surface->reliable_share() * gap : gap;
}

double Guards::gap(int guard) {
  if (gap_for_[guard] == configuration_) return gap_[guard];
  Contact contact;
  return evaluate_witness(guard, contact);
}

bool Guards::is_apart(int guard) {
  if (is_persistent(guard) || gap_for_[guard] == configuration_) return false;
  const Pair& pair = scene_->pairs[guard];
  if (!has_bounds(scene_->geometries[pair.a], scene_->geometries[pair.b])) return false;
  place_pair(guard);
  return known_bounds(guard).lower >= 0.0;
}

double Guards::evaluate_witness(int guard, Contact& contact) {
  gap_[guard] = find_nearest(guard, contact);
  gap_for_[guard] = configuration_;
  return gap_[guard];
}

bool Guards::has_closed_form(int guard) const {
  const Pair& pair = scene_->pairs[guard];
  return scene_->geometries[pair.a].unbounded != scene_->geometries[pair.b].unbounded ||
         manifolds_.has_capsules(guard) || manifolds_.has_common_normals(guard);
}

double Guards::find_nearest(int guard, Contact& contact) {
  ++counters.evaluated;
  if (guard >= pairs_) {
    const JointLimit& limit = scene_->tree.limits[guard - pairs_];
    contact = {limit_gap(guard, q_), Vec3::Zero(), Vec3::Zero(), Vec3::Zero(), -1, limit.joint};
    return contact.gap;
  }
  const Pair& pair = scene_->pairs[guard];
  const Geometry &a = scene_->geometries[pair.a], &b = scene_->geometries[pair.b];
  place_pair(guard);
  counters.cost += costs::near_distance();
  if (has_closed_form(guard) && manifolds_.nearest(guard, placements_, contact)) return contact.gap;
  // Of persistent points, too: what the fitted costs of steps hold, which decide when dense ones are taken.
  counters.cost += a.is_ball || b.is_ball ? costs::near_distance() : costs::distance();
  if (!nearest_of_points(guard, contact)) {
    const PosedShape shape_a = posed(pair, pair.a), shape_b = posed(pair, pair.b);
    ++counters.distances;
    distance_.evaluate(*shape_a.shape, shape_a.R, shape_a.p, *shape_b.shape, shape_b.R, shape_b.p, contact);
    contact.body_a = a.body;
    contact.body_b = b.body;
    if (pair.refined || (!a.is_ball && !b.is_ball && contact.gap < kFarApart))
      manifolds_.refine(guard, placements_, contact);
    if (has_bounds(a, b)) distance_bounds_.keep(guard, shape_a, shape_b, contact);
  }
  const Seams& seams = manifolds_.seams();
  if (contact.gap < Seams::kNear && seams.any(guard)) contact.gap += seams.slack(guard, placements_, contact);
  return contact.gap;
}

void Guards::gradient(int guard, const Contact& contact, VecRef W) const {
  if (guard < pairs_) {
    gap_gradient(scene_->tree, placements_, contact, W);
    return;
  }
  const JointLimit& limit = scene_->tree.limits[guard - pairs_];
  W.setZero();
  W[scene_->tree.joints[limit.joint].iv] = limit.upper ? -1.0 : 1.0;
}

void Guards::rows(int guard, const Contact& contact, const Vec3& t1, Eigen::Ref<MatX> W) {
  if (guard >= pairs_) {
    gradient(guard, contact, W.col(0));
    return;
  }
  place_pair(guard);
  contact_rows(scene_->tree, placements_, contact, t1, W.leftCols(std::min<Eigen::Index>(3, W.cols())));
  if (W.cols() < 3) return;
  if (has_axis(guard)) W.middleCols<2>(1) *= scene_->law(guard)->shares.asDiagonal();
  if (W.cols() == 3) return;
  const ContactLaw& law = *scene_->law(guard);
  turning_rows(scene_->tree, placements_, contact, t1, law.spinning, law.rolling, W.rightCols(W.cols() - 3));
}

Vec3 Guards::tangent(int guard, const Vec3& normal) {
  if (!has_axis(guard)) return any_tangent(normal);
  place_pair(guard);
  const ContactLaw& law = *scene_->law(guard);
  const Pair& pair = scene_->pairs[guard];
  const Geometry& g = scene_->geometries[law.axis_of == 0 ? pair.a : pair.b];
  Mat3 R;
  Vec3 p;
  geometry_pose(g, placements_, R, p);
  const Vec3 axis = R * law.axis;
  const Vec3 along = axis - axis.dot(normal) * normal;
  // An axis along the normal has no direction in the tangent plane.
  return along.norm() > kAcross ? Vec3(along.normalized()) : any_tangent(normal);
}

Eigen::Vector2d Guards::surface_velocity(int guard, const Contact& contact, const Vec3& t1, double t) {
  place_pair(guard);
  const auto of = [&](int geometry, const Vec3& x) -> Vec3 {
    const Geometry& g = scene_->geometries[geometry];
    if (g.motion < 0) return Vec3::Zero();
    Mat3 R;
    Vec3 p;
    geometry_pose(g, placements_, R, p);
    return R * scene_->surface_motions[g.motion].velocity(R.transpose() * (x - p), t);
  };
  const Vec3 u = of(scene_->pairs[guard].b, contact.point_b) - of(scene_->pairs[guard].a, contact.point_a);
  return frame(guard, contact, t1).rows(u);
}

void Guards::surface_turning(int guard, const Contact& contact, const Vec3& t1, double t, VecRef rates) {
  place_pair(guard);
  const auto of = [&](int geometry) -> Vec3 {
    const Geometry& g = scene_->geometries[geometry];
    if (g.motion < 0) return Vec3::Zero();
    Mat3 R;
    Vec3 p;
    geometry_pose(g, placements_, R, p);
    return R * scene_->surface_motions[g.motion].turning(t);
  };
  const Vec3 turning = of(scene_->pairs[guard].b) - of(scene_->pairs[guard].a);
  const ContactLaw& law = *scene_->law(guard);
  Eigen::Index k = 0;
  if (law.spinning > 0.0) rates[k++] = law.spinning * turning.dot(contact.normal);
  if (!(law.rolling > 0.0)) return;
  rates[k++] = law.rolling * turning.dot(t1);
  rates[k] = law.rolling * turning.dot(contact.normal.cross(t1));
}

double Guards::depth_tolerance(int guard) const {
  return guard < pairs_ ? std::max(kFeatureRounding, 1.2 * manifolds_.noise(guard)) : kFeatureRounding;
}

void Guards::bound_motion(const VecCRef& q, const VecX& bound, double h) {
  span_ended_ = span_.any();
  end_span();
  bounds_.bound_arms(q, bound, h, 1.0);
  bounds_.propagate(bound, h, motion_);
}

void Guards::bound_doubt(const VecX& doubt, double h) { bounds_.propagate(doubt, h, doubt_); }

void Guards::bound_bend(const VecX& bend, double h) { bounds_.propagate(bend, h, bend_); }

double Guards::motion(int guard) const { return bounds_.of(motion_, guard); }

double Guards::doubt(int guard) const { return bounds_.of(doubt_, guard); }

// A second derivative has the accelerations of the joints, which add up as velocities do, and for each two joints the
// product of their rates and the arm of the later one, twice: together no more than the turn times the motion.
double Guards::bend(int guard) const { return bounds_.of(bend_, guard) + 2.0 * turn(guard) * motion(guard); }

// The arms are those between two points of a shape, which is bounded.
double Guards::bend_about_points(int guard) const {
  return bounds_.longest_arm(guard) * (bounds_.turn_of(bend_, guard) + 2.0 * turn(guard) * turn(guard));
}

double Guards::doubt_about_points(int guard) const {
  return bounds_.longest_arm(guard) * bounds_.turn_of(doubt_, guard);
}

// In the frame of its shape the normal turns about an edge as the other edge does in the view along it, where that has
// the length of the sine s. With the turn w of the bodies, which adds 2 w^2 to what the joints bend it by, it turns by
// no more than w/s, and the second derivative of that is no more than (bend + 2 w^2)/s + 2 (w/s)^2; that of the normal
// has the square of its turn besides. A distance bends below its chord by an eighth of its second derivative.
double Guards::dip_of_others(int guard, double crossing) const {
  const double turned = turn(guard) / crossing;
  const double bend = bounds_.turn_of(bend_, guard) / crossing + 5.0 * turned * turned;
  return 0.125 * bend + bounds_.turn_of(doubt_, guard) / crossing;
}

bool Guards::is_along_one_direction(int guard) const {
  if (guard >= pairs_) return true;
  const Pair& pair = scene_->pairs[guard];
  const Geometry &a = scene_->geometries[pair.a], &b = scene_->geometries[pair.b], &half = a.unbounded ? a : b;
  if (!half.unbounded || half.surface || half.body != bounds_.base(guard)) return false;
  return !is_persistent(guard) || !manifolds_.has_rims(guard);
}

bool Guards::has_gap_along(int guard) const {
  if (guard >= pairs_ || is_persistent(guard)) return false;
  if (scene_->has_surface(guard)) return false;  // it reaches beyond its points
  const Pair& pair = scene_->pairs[guard];
  return is_along_one_direction(guard) ||
         (!scene_->geometries[pair.a].unbounded && !scene_->geometries[pair.b].unbounded);
}

double Guards::gap_along(int guard, const Vec3& direction) {
  place_pair(guard);
  const int base = bounds_.base(guard);
  return manifolds_.gap_along(guard, placements_, base < 0 ? direction : Vec3(placements_.R_W[base] * direction));
}

Vec3 Guards::direction(int guard, const Contact& contact) const {
  const int base = bounds_.base(guard);
  return base < 0 ? contact.normal : Vec3(placements_.R_W[base].transpose() * contact.normal);
}

double Guards::crossing_of_points(int guard) {
  if (guard >= pairs_ || !is_persistent(guard)) return 0.0;
  place_pair(guard);
  const std::vector<const ContactPoint*>& points = persistent_points_[persistent_number_[guard]];
  return manifolds_.crossing_of(guard, placements_, points.data(), static_cast<int>(points.size()));
}

// Of a pair whose bodies are placed.
bool Guards::nearest_of_points(int guard, Contact& contact) const {
  if (!is_persistent(guard)) return false;
  const std::vector<const ContactPoint*>& points = persistent_points_[persistent_number_[guard]];
  return manifolds_.nearest_of_points(guard, placements_, points.data(), static_cast<int>(points.size()), contact);
}

bool Guards::others_behind(int guard, double per_distance) {
  place_pair(guard);
  const std::vector<const ContactPoint*>& points = persistent_points_[persistent_number_[guard]];
  const Behind by{per_distance, kBehind};
  return manifolds_.others_behind(guard, placements_, points.data(), static_cast<int>(points.size()), by);
}

double Guards::turn(int guard) const { return bounds_.turn_of(motion_, guard); }

bool Guards::skip(int guard) const {
  if (guard >= pairs_) return false;  // a joint limit costs one subtraction
  return bounds_.both(odometer_, guard) + 2.0 * motion(guard) < marks_[guard];
}

bool Guards::separated_at_end(int guard) {
  if (guard >= pairs_) return limit_gap(guard, q_) > motion(guard);
  const double bound = cheap_bound(guard);
  if (!(bound > motion(guard))) return false;
  mark(guard, bound);
  return true;
}

// Where bodies are placed at the start of the step.
bool Guards::stays_apart(int guard) {
  if (guard >= pairs_) return limit_gap(guard, q_) > motion(guard);
  const double moved = bounds_.both(odometer_, guard);
  if (moved + motion(guard) < marks_[guard]) return true;
  const double bound = cheap_bound(guard);
  if (!(bound > motion(guard))) return false;
  if (!is_persistent(guard)) marks_[guard] = moved + reliable(guard, bound);
  return true;
}

// A lower bound on the distance of a pair: more than its motion if that can be had without the distance.
double Guards::cheap_bound(int guard) {
  place_pair(guard);
  const Pair& pair = scene_->pairs[guard];
  const Geometry &a = scene_->geometries[pair.a], &b = scene_->geometries[pair.b];
  if (!a.is_bounded() || !b.is_bounded()) {
    const Geometry &half = a.is_bounded() ? b : a, &other = a.is_bounded() ? a : b;
    Mat3 R;
    Vec3 p;
    geometry_pose(half, placements_, R, p);
    return (R * half.halfspace_normal).dot(sphere_center(other, placements_) - p) - half.halfspace_offset -
           other.radius;
  }
  const double bound = (sphere_center(a, placements_) - sphere_center(b, placements_)).norm() - a.radius - b.radius;
  return bound > motion(guard) || is_persistent(guard) ? bound : known_bounds(guard).lower;
}

void Guards::mark(int guard, double gap_at_end) {
  if (guard >= pairs_) return;
  const Pair& pair = scene_->pairs[guard];
  // Which other features a persistent guard looks at depends on how the shapes lie: motion does not bound their gaps.
  // Against a halfspace all of them are looked at.
  const bool all = scene_->geometries[pair.a].unbounded || scene_->geometries[pair.b].unbounded;
  if (is_persistent(guard) && (!all || gap_may_jump(guard))) return;
  marks_[guard] = bounds_.both(odometer_, guard) + motion(guard) + reliable(guard, gap_at_end);
}

// Before an odometer changes, or what a span expects.
void Guards::keep_start() {
  if (any_look_) return;
  for (std::size_t g = 0; g < odometer_.size(); ++g)
    interval_start_[g] = odometer_[g] + interval_used_ * expected_.geometry[g];
  any_look_ = true;
}

// Motions grow no less than in proportion to the length of a step.
void Guards::commit(double part) {
  keep_start();
  for (std::size_t g = 0; g < odometer_.size(); ++g) odometer_[g] += part * motion_.geometry[g];
}

// Each guard allows so many reference steps: a pair until its mark, a geometry until it may leave its fat box, a limit
// until its gap is used up.
void Guards::begin_span(const VecCRef& q1, const VecX& bound, double h) {
  keep_start();
  ++spans_;
  const VecX& path = span_.set_reference(bound, h);
  bounds_.bound_arms(q1, path, 1.0, ClearSpan::kLongest);
  bounds_.propagate(path, 1.0, expected_);
  double allowed = ClearSpan::kLongest;
  const auto limit = [&allowed](double room, double motion) {
    if (!(room >= allowed * motion)) allowed = room / motion;
  };
  for (std::size_t g = 0; g < scene_->geometries.size(); ++g)
    limit(broad_phase_.limit(static_cast<int>(g)) - odometer_[g], expected_.geometry[g]);
  for (int k = pairs_; k < count_; ++k) limit(limit_gap(k, q1), expected_.limit[k - pairs_]);
  if (!(allowed > 0.0)) return;
  if (pairs_ > 0) {
    place(q1);
    const double pairs = span_of_pairs(allowed);
    if (!(pairs >= allowed)) allowed = pairs;
  }
  if (allowed > 0.0) span_.allow(allowed);
}

// How many reference steps the near pairs allow, where `enough` are wanted. As long as one pair alone makes them few
// its distance is found better, once.
double Guards::span_of_pairs(double enough) {
  const std::vector<BroadPhase::NearPair>& near = broad_phase_.near_pairs();
  const BroadPhase::NearPair* refined = nullptr;
  for (std::size_t k = 0; k <= near.size(); ++k) {
    const BroadPhase::NearPair* first = nullptr;
    double least = enough;
    for (const BroadPhase::NearPair& pair : near) {
      const double steps = span_of(pair);
      if (steps >= least) continue;
      least = steps;
      first = &pair;
    }
    if (first == nullptr || first == refined || !(least < kShortSpan) || !refine(*first)) return least;
    refined = first;
  }
  return 0.0;
}

double Guards::span_of(const BroadPhase::NearPair& pair) const {
  const double room = marks_[pair.guard] - bounds_.both(odometer_, pair.guard),
               motion = bounds_.both(expected_.geometry, pair.guard);
  return room >= ClearSpan::kLongest * motion ? ClearSpan::kLongest : room / motion;
}

// Finds a better bound on the distance of a pair where the bodies are placed, after the step: that of its boxes, that
// from its last evaluation, or the distance. False: there is none.
bool Guards::refine(const BroadPhase::NearPair& pair) {
  if (is_persistent(pair.guard)) return false;
  const double odometers = bounds_.both(odometer_, pair.guard), before = marks_[pair.guard],
               motion = bounds_.both(expected_.geometry, pair.guard);
  const double distance = distance_bound(pair.guard, kShortSpan * motion);
  if (!(odometers + distance > before)) return false;
  marks_[pair.guard] = odometers + distance;
  return true;
}

void Guards::end_span() {
  if (span_.any()) keep_start();
  if (span_.any())
    for (std::size_t g = 0; g < odometer_.size(); ++g) odometer_[g] += span_.used() * expected_.geometry[g];
  span_.end();
}

Guards::Memory Guards::memory() const {
  Memory memory{odometer_, marks_, broad_phase_.memory()};
  for (std::size_t g = 0; g < odometer_.size(); ++g) memory.odometer[g] = odometer(static_cast<int>(g));
  return memory;
}

}  // namespace contactvi

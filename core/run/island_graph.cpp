#include "run/island_graph.hpp"

#include <coal/collision_object.h>
#include <coal/shape/geometric_shapes.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/numerics.hpp"
#include "geometry/box.hpp"

namespace contactvi {

namespace {
// A ball's margin lasts for about so many of them, for fewer where it has many neighbours: to look at one of these in
// each interval costs as much as kLook balls cost where a ball is renewed, which is compared with all.
constexpr double kIntervals = 16.0, kFewIntervals = 2.0, kLook = 10.0;
constexpr double kMargin = 0.05;  // it is at least this part of its radius;
constexpr double kHuge = 1e300;   // stands for one over nothing
// Where balls are renewed, or clear intervals have ended, those with less than this part of their margin left are
// renewed: else each would end the clear intervals by itself. A bound on a distance that does not last as long as what
// a ball is left with, kRenewed * kIntervals reaches, gives way to the exact distance.
constexpr double kRenewed = 0.5;
}  // namespace

IslandGraph::IslandGraph(const StaticTrees& trees, Guards& guards)
    : trees_(&trees), guards_(&guards), scene_(&guards.scene()), paths_(guards.scene().geometries.size()) {
  const std::size_t n = scene_->geometries.size();
  partners_.resize(n);
  for (std::size_t k = 0; k < scene_->pairs.size(); ++k) {
    const Pair& pair = scene_->pairs[k];
    const int a = trees.of_geometry(pair.a), b = trees.of_geometry(pair.b), guard = static_cast<int>(k);
    if (a == b || a < 0 || b < 0) continue;
    partners_[pair.a].push_back({pair.b, guard});
    partners_[pair.b].push_back({pair.a, guard});
  }
  slot_.assign(n, -1);
  for (std::size_t g = 0; g < n; ++g) {
    const Geometry& geometry = scene_->geometries[g];
    sphere_.push_back(geometry.sharp->getNodeType() == coal::GEOM_SPHERE ? 1 : 0);
    radius_.push_back(sphere_[g]           ? static_cast<const coal::Sphere&>(*geometry.sharp).radius
                      : geometry.unbounded ? std::numeric_limits<double>::infinity()
                                           : geometry.radius);
    std::sort(partners_[g].begin(), partners_[g].end(),
              [](const Partner& a, const Partner& b) { return a.geometry < b.geometry; });
    if (partners_[g].empty()) continue;
    slot_[g] = static_cast<int>(movable_.size());
    movable_.push_back(static_cast<int>(g));
  }
  neighbours_.resize(n);
  is_active_.assign(n, 0);
  intervals_.assign(n, kIntervals);
  for (std::vector<double>* list : {&reach_, &motion_, &odometer_, &limit_, &inverse_}) list->assign(n, 0.0);
  for (std::vector<double>* list : {&x_, &y_, &z_, &ball_}) list->assign(movable_.size(), 0.0);
}

void IslandGraph::set_active(std::vector<int> geometries) {
  for (int g : active_) is_active_[g] = 0;
  std::swap(active_, geometries);
  active_.erase(std::remove_if(active_.begin(), active_.end(), [this](int g) { return slot_[g] < 0; }), active_.end());
  std::sort(active_.begin(), active_.end());
  for (int g : active_) is_active_[g] = 1;
  for (int g : geometries)
    if (!is_active_[g]) reach_[g] = 0.0;
}

void IslandGraph::restart(const std::vector<double>& motion, const MatX& straight) {
  set_active(movable_);
  motion_ = motion;
  paths_.restart(straight);
  approaching_.clear();
  knows_motion_ = true;
  room_ = used_ = largest_ = last_ = 0.0;
  std::fill(odometer_.begin(), odometer_.end(), 0.0);
  std::fill(limit_.begin(), limit_.end(), -1.0);
  std::fill(ball_.begin(), ball_.end(), -std::numeric_limits<double>::infinity());  // overlaps nothing
  for (std::vector<Neighbour>& list : neighbours_) list.clear();
}

void IslandGraph::place(const VecX& q) {
  if (!placed_) guards_->place(q);
  placed_ = true;
}

int IslandGraph::guard_of(int a, int b) const {
  const std::vector<Partner>& list = partners_[a];
  const auto at = std::lower_bound(list.begin(), list.end(), b, [](const Partner& p, int g) { return p.geometry < g; });
  return at != list.end() && at->geometry == b ? at->guard : -1;
}

// Puts the ball of a geometry where that is now, and finds its neighbours anew.
void IslandGraph::renew(int g, double margin) {
  before_.clear();
  for (const Neighbour& n : neighbours_[g]) {
    std::vector<Neighbour>& list = neighbours_[n.geometry];
    const auto own = std::find_if(list.begin(), list.end(), [g](const Neighbour& m) { return m.geometry == g; });
    before_.push_back({n.geometry, n.guard, std::max(n.mark, own->mark)});
    list.erase(own);
  }
  neighbours_[g].clear();
  const Placements& at = guards_->placements_of(g);
  const Geometry& geometry = scene_->geometries[g];
  const Vec3 c = at.p_W[geometry.body] + at.R_W[geometry.body] * geometry.center_B;
  const int slot = slot_[g];
  x_[slot] = c[0];
  y_[slot] = c[1];
  z_[slot] = c[2];
  ball_[slot] = radius_[g] + margin;
  limit_[g] = odometer_[g] + margin;
  const double *x = x_.data(), *y = y_.data(), *z = z_.data(), *ball = ball_.data(), cx = c[0], cy = c[1], cz = c[2],
               own = ball_[slot];
  const int tree = trees_->of_geometry(g), count = static_cast<int>(movable_.size());
  for (int k = 0; k < count; ++k) {
    const double dx = x[k] - cx, dy = y[k] - cy, dz = z[k] - cz, r = ball[k] + own;
    if (!(r > 0.0 && dx * dx + dy * dy + dz * dz <= r * r)) continue;
    const int other = movable_[k];
    if (trees_->of_geometry(other) == tree) continue;
    const int guard = guard_of(g, other);
    if (guard < 0) continue;
    const auto known =
        std::find_if(before_.begin(), before_.end(), [&](const Neighbour& m) { return m.guard == guard; });
    const double mark = known != before_.end() ? known->mark : -1.0;
    neighbours_[g].push_back({other, guard, mark});
    neighbours_[other].push_back({g, guard, mark});
  }
  // Twice the margin has up to eight times the neighbours. After clear intervals, in which nobody looked at them, they
  // cost nothing.
  const double looks = was_clear_ ? 0.0 : kLook * static_cast<double>(neighbours_[g].size()) * intervals_[g];
  if (looks > count)
    intervals_[g] = std::max(kFewIntervals, 0.5 * intervals_[g]);
  else if (16.0 * looks < count)
    intervals_[g] = std::min(kIntervals, 2.0 * intervals_[g]);
}

// That of their balls, and that of their boxes where this would not last for `reach`.
IslandGraph::Apart IslandGraph::clearance(const Neighbour& n, int g, double reach) {
  const Placements& at = guards_->placements(n.guard);
  const Geometry &a = scene_->geometries[g], &b = scene_->geometries[n.geometry];
  const auto center = [&](const Geometry& geometry) {
    return Vec3(at.p_W[geometry.body] + at.R_W[geometry.body] * geometry.center_B);
  };
  const Vec3 line = center(b) - center(a);
  const double length = line.norm();
  Apart apart{length - radius_[g] - radius_[n.geometry], Vec3::Zero()};
  if (apart.distance > 0.0) apart.direction = line / length;
  if (apart.distance > reach || a.unbounded || b.unbounded || (sphere_[g] && sphere_[n.geometry])) return apart;
  const Box box_a = box_of(a, at), box_b = box_of(b, at);
  const double boxes = separation(box_a, box_b);
  if (boxes > apart.distance) apart = {boxes, boxes > 0.0 ? separating_axis(box_a, box_b) : Vec3::Zero()};
  return apart;
}

// As found by their shapes. Convex ones are apart along the normal.
IslandGraph::Apart IslandGraph::exact_distance(const Neighbour& n, int g) {
  Contact contact;
  const double distance = guards_->evaluate_witness(n.guard, contact);
  if (scene_->has_surface(n.guard) || !(distance > 0.0)) return {distance, Vec3::Zero()};
  return {distance, scene_->pairs[n.guard].a == g ? contact.normal : Vec3(-contact.normal)};
}

// By how much two neighbours have approached each other at most, by the motions that were told last.
double IslandGraph::approach(int g, const Neighbour& n, const Vec3& direction) const {
  return std::min(motion_[g] + motion_[n.geometry], paths_.approach(g, n.geometry, direction));
}

// Whether two neighbours may meet in an interval.
bool IslandGraph::may_meet(int g, Neighbour& n, const Moves& moves) {
  const double odometers = odometer_[g] + odometer_[n.geometry], reach = moves.together;
  if (odometers + reach < n.mark) return false;
  const double most = std::min(reach, moves.share * approach(g, n, Vec3::Zero()));
  const double lasting = kRenewed * kIntervals * most;
  Apart apart = clearance(n, g, lasting);
  const auto stays = [&] {
    return apart.distance > most || (!apart.direction.isZero(0.0) &&
                                     apart.distance > std::min(reach, moves.share * approach(g, n, apart.direction)));
  };
  if (apart.distance <= lasting && !(sphere_[g] && sphere_[n.geometry])) {
    apart = {guards_->distance_bound(n.guard, lasting), Vec3::Zero()};
    if (!stays()) apart = exact_distance(n, g);
  }
  if (!stays()) return true;
  n.mark = odometers + apart.distance;
  if (!(apart.distance > reach)) approaching_.push_back({g, n, apart});
  return false;
}

// Trees that are joined may part, whatever their geometries move: while there are such neighbours there is no room.
void IslandGraph::find_room(DisjointSets& sets) {
  ++rooms_;
  used_ = last_ = 0.0;
  room_ = std::numeric_limits<double>::infinity();
  const auto limit = [this](double room) {
    if (!(room >= room_)) room_ = room;  // NaN stays
  };
  for (int g : active_) inverse_[g] = reach_[g] > 0.0 ? 1.0 / reach_[g] : kHuge;
  for (int g : active_) {
    limit((limit_[g] - odometer_[g]) * inverse_[g]);
    for (const Neighbour& n : neighbours_[g]) {
      if (!looks_at(g, n)) continue;
      if (sets.joined(trees_->of_geometry(g), trees_->of_geometry(n.geometry))) {
        room_ = 0.0;
        return;
      }
      limit((n.mark - odometer_[g] - odometer_[n.geometry]) / (reach_[g] + reach_[n.geometry]));
    }
  }
}

bool IslandGraph::find_clear() {
  placed_ = false;
  was_clear_ = clear_;
  // What counts as x reference intervals has a reach of at most kReach x + 1 of them in the next one: the slack is a
  // part of each reach.
  clear_ = is_clear(used_, last_);
  measured_ = !clear_;
  approaching_.clear();
  return clear_;
}

int IslandGraph::foresee(const std::vector<double>& counts) const {
  double used = used_, last = last_;
  int intervals = 0;
  for (double count : counts) {
    if (!is_clear(used, last) || !(used + count < room_)) break;
    used += count;
    last = count;
    ++intervals;
  }
  return intervals;
}

void IslandGraph::pass(const std::vector<double>& counts, int intervals) {
  was_clear_ = intervals > 1 || clear_;
  clear_ = true;
  placed_ = measured_ = knows_motion_ = false;
  for (int k = 0; k < intervals; ++k) used_ += counts[k];
  last_ = counts[intervals - 1];
  largest_ = 0.0;
}

void IslandGraph::join_suspects(const VecX& q, double slack, DisjointSets& sets) {
  joins_.clear();
  bool outdated = was_clear_;
  for (int g : active_) {
    reach_[g] = kReach * motion_[g] + slack;
    outdated |= !(odometer_[g] + reach_[g] <= limit_[g]);
  }
  for (int g : active_) {
    if (!outdated) break;
    const double margin = std::max(intervals_[g] * reach_[g], std::isfinite(radius_[g]) ? kMargin * radius_[g] : 0.0);
    if (odometer_[g] + std::max(reach_[g], kRenewed * margin) <= limit_[g]) continue;
    place(q);
    renew(g, margin);
  }
  for (int g : active_) {
    for (Neighbour& n : neighbours_[g]) {
      if (!looks_at(g, n) || sets.joined(trees_->of_geometry(g), trees_->of_geometry(n.geometry))) continue;
      const double reach = reach_[g] + reach_[n.geometry];
      if (odometer_[g] + odometer_[n.geometry] + reach < n.mark) continue;
      place(q);
      if (may_meet(g, n, {reach, paths_.foretold(g) && paths_.foretold(n.geometry) ? 1.0 : kReach})) join(g, n, sets);
    }
  }
  find_room(sets);
}

void IslandGraph::join(int g, const Neighbour& n, DisjointSets& sets) {
  joins_.emplace_back(trees_->of_geometry(g), trees_->of_geometry(n.geometry));
  sets.join(joins_.back().first, joins_.back().second);
}

void IslandGraph::join_met(const VecX& q, DisjointSets& sets) {
  joins_.clear();
  if (clear_) std::fill(reach_.begin(), reach_.end(), 0.0);  // all that move are looked at
  for (const Approaching& pair : approaching_)
    if (!(pair.apart.distance > approach(pair.geometry, pair.neighbour, pair.apart.direction)))
      join(pair.geometry, pair.neighbour, sets);
  bool any = false;
  for (int g : active_) any |= motion_[g] > reach_[g];
  if (!any) return;
  place(q);
  for (int g : active_)
    if (odometer_[g] + motion_[g] > limit_[g]) renew(g, intervals_[g] * motion_[g]);
  for (int g : active_) {
    if (!(motion_[g] > reach_[g])) continue;
    for (Neighbour& n : neighbours_[g]) {
      const int a = trees_->of_geometry(g), b = trees_->of_geometry(n.geometry);
      if (!sets.joined(a, b) && may_meet(g, n, {motion_[g] + motion_[n.geometry], 1.0})) join(g, n, sets);
    }
  }
}

void IslandGraph::know_motion() {
  for (int g : active_) odometer_[g] += motion_[g];
  largest_ = 0.0;
  knows_motion_ = true;
}

void IslandGraph::commit() {
  knows_motion_ = measured_;
  if (measured_)
    for (int g : active_) odometer_[g] += motion_[g];
  used_ += largest_;
  last_ = largest_;
  largest_ = 0.0;
}

}  // namespace contactvi

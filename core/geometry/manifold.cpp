#include "geometry/manifold.hpp"

#include <coal/shape/geometric_shapes.h>

#include <algorithm>
#include <array>
#include <limits>

#include "base/refusal.hpp"
#include "geometry/line_contact.hpp"
#include "geometry/nearest_features.hpp"
#include "geometry/other_features.hpp"
#include "geometry/solid_pair.hpp"
#include "geometry/surface_frame.hpp"

namespace contactvi {

void set_contact(const ContactPoint& p, const Vec3& n, const Vec3& lowest, double gap, Contact& contact) {
  const Vec3 on_other = lowest - p.radius * n, on_plane = on_other - gap * n;
  contact.gap = gap;
  contact.normal = p.on_b ? n : Vec3(-n);
  contact.point_a = p.on_b ? on_plane : on_other;
  contact.point_b = p.on_b ? on_other : on_plane;
  contact.body_a = p.on_b ? p.plane_body : p.point_body;
  contact.body_b = p.on_b ? p.point_body : p.plane_body;
}

namespace {

// A nearest point at most this far from a face's plane lies on the face [m]: the accuracy of coal's nearest points.
constexpr double kOnFace = 1e-6;
// Of the noise of coal's distance: a distance that is deeper than the persistent points by more is another feature.
constexpr double kBelow = 1.1;
// [m] By which the distance of a pair may be less than that of its features although no other feature is nearer. Held
// by the gaps of tests/batteries/test_contact_battery.py.
constexpr double kWitnessNoise = 6e-11;
// [m] Features that are in front of others by less make no other distance.
constexpr double kSameDistance = 1e-13;
// Of the noise: such a distance counts from here on.
constexpr double kDeeper = 0.5;
// Features that touch because others do keep the gap that they have: it would jump to and fro.
static_assert((kBelow - kDeeper) * kWitnessNoise > kNextGapSlack);

// The face of o whose normal is closest to n, of those that contain the surface point x (world) of its core if there
// are any; -1 if no face has a normal along n.
int facing_face(const ShapeFeatures& o, const Pose& pose, const Vec3& n_W, const Vec3& x_W) {
  if (o.is_unbounded()) return 0;
  const Vec3 n = pose.R.transpose() * n_W, x = pose.into(x_W);
  int best = -1, best_on = -1;
  double most = kFacing, most_on = kFacing;
  for (int f = 0; f < static_cast<int>(o.faces.size()); ++f) {
    const double along = o.faces[f].normal.dot(n);
    if (along > most) {
      most = along;
      best = f;
    }
    if (along > most_on && std::abs(o.faces[f].normal.dot(x) - o.faces[f].offset) < kOnFace) {
      most_on = along;
      best_on = f;
    }
  }
  return best_on >= 0 ? best_on : best;
}

class Collect final : public CandidateSink {
 public:
  Collect(double margin, std::vector<Candidate>& found) : found_(found) { limit = margin; }
  void add(const Candidate& c) override { found_.push_back(c); }

 private:
  std::vector<Candidate>& found_;
};

// From this tilt [rad] on, the far side of a rolling rim cannot close before the points are found again.
constexpr double kNearlyFlat = 0.1;
// Factor on the tolerances of find within which a point stays valid, so that a point just found is valid.
constexpr double kStay = 2.0;
// A point of a contact lies no deeper than kOverlap times the overlap of the pair and kSameOverlap [m], which is more
// than the noise of coal's distances and the gaps of contacts that persist.
constexpr double kOverlap = 2.0, kSameOverlap = 1e-7;

// The shapes and features of a pair that a feature number names: `other` lies over face `face` of `plane`.
struct Parts {
  Feature kind;
  bool on_b;
  const ShapeFeatures *plane, *other;
  const Pose *plane_pose, *other_pose;
  int face, i;
  int rim;  // -1: none
};

Parts parts_of(const PairView& v, std::int64_t n) {
  Parts p;
  p.kind = feature_kind(n);
  p.on_b = feature_on_b(n);
  p.plane = p.on_b ? v.a : v.b;
  p.other = p.on_b ? v.b : v.a;
  p.plane_pose = p.on_b ? &v.pose_a : &v.pose_b;
  p.other_pose = p.on_b ? &v.pose_b : &v.pose_a;
  p.i = feature_i(n);
  const bool is_side = p.kind == Feature::kRimSideA || p.kind == Feature::kRimSideB;
  p.face = is_side ? p.plane->ring_face[feature_j(n) / 2] : is_end(p.kind) || is_rim_line(p.kind) ? -1 : feature_j(n);
  // Over an unbounded plane that has stood in for a surface the number tells the foot.
  if (p.face > 0 && p.plane->is_unbounded()) p.face = 0;
  p.rim = feature_rim(n);
  return p;
}

// The edges of a and of b that a feature of two edges names.
std::array<int, 2> edges_of(std::int64_t n) {
  if (feature_kind(n) == Feature::kEdges) return {feature_i(n), feature_j(n)};
  const int edge = is_end(feature_kind(n)) ? feature_i(n) / 2 : 0;  // a cylinder has one edge, its axis
  if (feature_on_b(n)) return {feature_j(n), edge};
  return {edge, feature_j(n)};
}

class Lists final : public CandidateSink {
 public:
  explicit Lists(std::int64_t feature) : feature_(feature) { limit = kInfinity; }
  void add(const Candidate& c) override { found |= c.feature == feature_; }
  bool found = false;

 private:
  std::int64_t feature_;
};

bool is_over_line(const PairView& v, std::int64_t n) {
  const auto [i, j] = edges_of(n);
  Lists sink(n);
  list_line_ends(v, i, line_of(*v.a, v.pose_a, i), j, line_of(*v.b, v.pose_b, j), false, sink);
  return sink.found;
}

// The face of `faces` whose normal is closest to n; -1 if no normal is along n.
template <class Faces>
int most_facing(const ShapeFeatures& o, const Pose& pose, const Vec3& n_W, const Faces& faces) {
  const Vec3 n = pose.R.transpose() * n_W;
  int best = -1;
  double most = kFacing;
  for (int f : faces) {
    if (f < 0 || o.faces[f].normal.dot(n) <= most) continue;
    most = o.faces[f].normal.dot(n);
    best = f;
  }
  return best;
}

// World position of a point of a body, and a vector turned into the world.
Vec3 point_W(const Placements& at, int body, const Vec3& x) {
  return body < 0 ? x : Vec3(at.p_W[body] + at.R_W[body] * x);
}
Vec3 turned_W(const Placements& at, int body, const Vec3& x) { return body < 0 ? x : Vec3(at.R_W[body] * x); }
// And from the world into a body's frame.
Vec3 point_B(const Placements& at, int body, const Vec3& x_W) {
  return body < 0 ? x_W : Vec3(at.R_W[body].transpose() * (x_W - at.p_W[body]));
}
Vec3 turned_B(const Placements& at, int body, const Vec3& x_W) {
  return body < 0 ? x_W : Vec3(at.R_W[body].transpose() * x_W);
}

// Gap of a point fixed to point_body, swept by the radius, against the plane.
double vertex_gap(const ContactPoint& p, const Vec3& center_B, const Placements& at, Contact& contact) {
  const Vec3 c = point_W(at, p.point_body, center_B), n = turned_W(at, p.plane_body, p.normal_B);
  const Vec3 from = p.plane_body < 0 ? c : Vec3(c - at.p_W[p.plane_body]);
  const double gap = n.dot(from) - p.offset - p.radius;
  set_contact(p, n, c, gap, contact);
  return gap;
}

void rim_gap(const ContactPoint& p, const Placements& at, Contact& contact) {
  const Vec3 c = point_W(at, p.point_body, p.center_B), n = turned_W(at, p.plane_body, p.normal_B);
  const Vec3 axis = turned_W(at, p.point_body, p.axis_B);
  const Vec3 from = p.plane_body < 0 ? c : Vec3(c - at.p_W[p.plane_body]);
  const double gap = n.dot(from) - rim_tilt(p.rim_radius, axis, n) - p.offset - p.radius;
  set_contact(p, n, lowest_of_rim(c, axis, p.rim_radius, n), gap, contact);
}

void edge_gap(const ContactPoint& p, const Placements& at, Contact& contact) {
  const Vec3 ea = turned_W(at, p.plane_body, p.normal_B), eb = turned_W(at, p.point_body, p.axis_B);
  const Vec3 pa = point_W(at, p.plane_body, p.origin_B), pb = point_W(at, p.point_body, p.center_B);
  const Vec3 cross = ea.cross(eb), d = pb - pa;
  const double square = std::max(cross.squaredNorm(), std::numeric_limits<double>::min());
  contact.normal = cross / std::sqrt(square);
  contact.gap = d.dot(contact.normal) - p.offset - p.radius;
  contact.point_a = pa + d.cross(eb).dot(cross) / square * ea + p.offset * contact.normal;
  contact.point_b = pb + d.cross(ea).dot(cross) / square * eb - p.radius * contact.normal;
  contact.body_a = p.plane_body;
  contact.body_b = p.point_body;
}

void end_gap(const ContactPoint& p, const Placements& at, Contact& contact) {
  const Vec3 x = point_W(at, p.point_body, p.center_B), d = turned_W(at, p.plane_body, p.normal_B);
  const Vec3 from = x - point_W(at, p.plane_body, p.origin_B);
  const Vec3 apart = from - from.dot(d) * d;
  const double distance = apart.norm();
  const Vec3 n = distance > 0.0 ? Vec3(apart / distance) : any_tangent(d);
  set_contact(p, n, x, distance - p.radius - p.offset, contact);
}

// The core's point of a rim that is nearest to the line; apart: from the line to it.
Vec3 rim_line_point(const ContactPoint& p, const Placements& at, Vec3& apart) {
  Vec3 x = point_W(at, p.point_body, p.far_B);
  apart = nearest_on_rim(point_W(at, p.point_body, p.center_B), turned_W(at, p.point_body, p.axis_B), p.rim_radius,
                         point_W(at, p.plane_body, p.origin_B), turned_W(at, p.plane_body, p.normal_B), x);
  return x;
}

void rim_line_gap(const ContactPoint& p, const Placements& at, Contact& contact) {
  Vec3 apart;
  const Vec3 x = rim_line_point(p, at, apart);
  const double distance = apart.norm();
  const Vec3 n = distance > 0.0 ? Vec3(apart / distance) : turned_W(at, p.point_body, p.axis_B);
  set_contact(p, n, x, distance - p.radius - p.offset, contact);
}

// Makes a point of b over a plane of a of the point that has this contact.
void make_material(ContactPoint& p, const Placements& at, const Contact& contact) {
  p.kind = PointKind::kVertex;
  p.on_b = true;
  p.radius = 0.0;
  p.point_body = contact.body_b;
  p.plane_body = contact.body_a;
  p.center_B = point_B(at, contact.body_b, contact.point_b);
  p.normal_B = turned_B(at, contact.body_a, contact.normal);
  p.offset = p.normal_B.dot(point_B(at, contact.body_a, contact.point_a));
}

// How far a vertex, or the lowest point of a rim, is from the border of the face of its feature; negative beyond it.
double inside(const Parts& parts, const ContactPoint& point, const Placements& at) {
  if (parts.plane->is_unbounded()) return std::numeric_limits<double>::infinity();
  const ShapeFeatures::Face& face = parts.plane->faces[parts.face];
  Vec3 x = point_W(at, point.point_body, point.center_B);
  if (point.kind == PointKind::kRim) {
    const Vec3 n = parts.plane_pose->R * face.normal;
    x = lowest_of_rim(x, turned_W(at, point.point_body, point.axis_B), point.rim_radius, n);
  }
  return -outside_of(*parts.plane, face, parts.plane_pose->into(x));
}

bool is_over(const Parts& parts, const ContactPoint& point, const Placements& at) {
  return inside(parts, point, at) >= -kStay * kBorder;
}

}  // namespace

// The candidate with the least gap that is no persistent contact.
class Manifolds::Least final : public CandidateSink {
 public:
  Least(const Manifolds& owner, int pair, const Placements& at, const ContactPoint* const* persistent, int count,
        double enough)
      : owner_(owner), at_(at), persistent_(persistent), count_(count), enough_(enough) {
    limit = enough;
    falls = true;
    supported_ = count >= std::min(owner.has_common_normals(pair) ? 2 : 3, owner.max_points_);
  }

  void add(const Candidate& c) override {
    double slack = supported_ ? kNextGapSlack : 0.0;
    const int rim = feature_rim(c.feature);
    for (int i = 0; i < count_; ++i) {
      const ContactPoint& h = *persistent_[i];
      if (h.feature == c.feature) return;
      if (rim >= 0 && feature_rim(h.feature) == rim && feature_on_b(h.feature) == feature_on_b(c.feature))
        slack = kNextGapSlack;
    }
    if (c.gap + slack > limit || (c.gap + slack == limit && !is_before(c))) return;
    for (int i = 0; i < count_; ++i) {
      if (persistent_[i]->kind == PointKind::kLimit) continue;
      if (slack == 0.0 && is_same_place(*persistent_[i], c)) return;
    }
    limit = c.gap + slack;
    best = c;
  }

  double value() const { return limit < enough_ ? limit : kInfinity; }
  Candidate best{};

 private:
  // Of vertices over one face that are equally near the first one counts, whatever the order in which they come.
  bool is_before(const Candidate& c) const {
    return limit < enough_ && feature_kind(c.feature) == feature_kind(best.feature) &&
           feature_j(c.feature) == feature_j(best.feature) && c.feature < best.feature;
  }
  // Two features may name one point: a corner on a corner.
  bool is_same_place(const ContactPoint& h, const Candidate& c) const {
    if (h.kind == PointKind::kWitness) return false;
    Contact contact;
    owner_.evaluate(h, at_, contact);
    Vec3 d = c.x_W - 0.5 * (contact.point_a + contact.point_b);
    d -= d.dot(contact.normal) * contact.normal;
    return d.squaredNorm() < kSamePlace * kSamePlace && c.gap > contact.gap - kSameGap;
  }

  const Manifolds& owner_;
  const Placements& at_;
  const ContactPoint* const* persistent_;
  int count_;
  double enough_;
  bool supported_;  // at enough points to fix the faces to each other
};

// Leaves out crossings of edges that are none of the union of a shape and its neighbours.
class Manifolds::OfUnion final : public CandidateSink {
 public:
  OfUnion(const Manifolds& owner, int pair, const Placements& at, const PairView& v, const Vec3& n_W,
          CandidateSink& sink)
      : owner_(owner), pair_(pair), at_(at), v_(v), n_W_(n_W), sink_(sink), any_(owner.seams_.any(pair)) {
    limit = sink.limit;
    falls = sink.falls;
  }

  void add(const Candidate& c) override {
    if (any_ && feature_kind(c.feature) == Feature::kEdges && is_inner(c)) return;
    sink_.add(c);
    limit = sink_.limit;
  }

 private:
  bool is_inner(const Candidate& c) const {
    const Vec3 a = v_.pose_a.R * v_.a->edges[feature_i(c.feature)].direction,
               b = v_.pose_b.R * v_.b->edges[feature_j(c.feature)].direction;
    const Vec3 n = a.cross(b).normalized();
    return owner_.seams_.goes_on(pair_, at_, c.x_W, n.dot(n_W_) < 0.0 ? Vec3(-n) : n, a, b);
  }

  const Manifolds& owner_;
  int pair_;
  const Placements& at_;
  const PairView& v_;
  const Vec3& n_W_;
  CandidateSink& sink_;
  bool any_;
};

Manifolds::Manifolds(const Scene& scene, int max_points)
    : scene_(&scene), seams_(scene), max_points_(std::max(1, max_points)) {
  for (const Geometry& g : scene.geometries) {
    is_capsule_.push_back(g.sharp->getNodeType() == coal::GEOM_CAPSULE);
    any_feet_ |= g.surface && g.surface->knows_all_feet();
  }
  for (int k = 0; k < static_cast<int>(scene.pairs.size()); ++k)
    if (scene.geometries[scene.pairs[k].a].unbounded && scene.geometries[scene.pairs[k].b].unbounded &&
        !has_common_normals(k))
      throw Refusal("Two halfspaces cannot touch each other", "at most one halfspace in a pair", "two",
                    "Take the pair out: scene.disable_pair(a, b)");
}

bool Manifolds::has_common_normals(int pair) const { return any_feet_ && SolidPair::is_one(*scene_, pair); }

const ShapeFeatures& Manifolds::features(int pair, int geometry) const {
  return shape_features_of(scene_->geometries[geometry], scene_->pairs[pair].rounded);
}

// Whether coal's point is the only one of the pair.
bool Manifolds::is_single(int pair) const {
  if (has_common_normals(pair)) return false;
  const ShapeFeatures &a = features(pair, scene_->pairs[pair].a), &b = features(pair, scene_->pairs[pair].b);
  auto is_empty = [](const ShapeFeatures& o) { return o.vertices.empty() && o.faces.empty(); };
  auto is_point = [](const ShapeFeatures& o) { return o.vertices.size() == 1; };
  return is_empty(a) || is_empty(b) || (is_point(a) && !b.is_unbounded()) || (is_point(b) && !a.is_unbounded());
}

double Manifolds::noise(int pair) const {
  const Pair& p = scene_->pairs[pair];
  const ShapeFeatures &a = features(pair, p.a), &b = features(pair, p.b);
  // Over a halfspace the lowest corner gives the distance, wherever it lies on its face.
  const bool over_halfspace = a.is_unbounded() || b.is_unbounded();
  return kWitnessNoise + (over_halfspace ? 0.0 : a.roughness + b.roughness);
}

PairView Manifolds::view(int pair, const Placements& at) const {
  const Pair& p = scene_->pairs[pair];
  const int body_a = scene_->geometries[p.a].body, body_b = scene_->geometries[p.b].body;
  return {&features(pair, p.a), &features(pair, p.b), pose_of(body_a, at), pose_of(body_b, at), body_a, body_b};
}

Sides Manifolds::sides_of_witness(const PairView& v, const Contact& witness) const {
  Sides s;
  s.n_W = witness.normal;
  if (v.a->is_unbounded()) s.n_W = v.pose_a.R * v.a->faces[0].normal;
  if (v.b->is_unbounded()) s.n_W = -(v.pose_b.R * v.b->faces[0].normal);
  const Vec3 x_a = witness.point_a - v.a->radius * s.n_W, x_b = witness.point_b + v.b->radius * s.n_W;
  // For a convex body on a halfspace only the face of the halfspace counts.
  if (!v.b->is_unbounded()) s.a = facing_face(*v.a, v.pose_a, s.n_W, x_a);
  if (!v.a->is_unbounded()) s.b = facing_face(*v.b, v.pose_b, -s.n_W, x_b);
  return s;
}

void Manifolds::find(int pair, const Placements& at, const Contact& witness, double margin,
                     std::vector<ContactPoint>& points, std::vector<ContactPoint>* others,
                     std::vector<std::int64_t>* left) {
  if (!(witness.gap <= margin)) return;
  const PairView v = view(pair, at);
  found_.clear();
  const Candidate nearest{0, witness.gap, 0.5 * (witness.point_a + witness.point_b)};
  Vec3 n = witness.normal;
  if (!is_single(pair)) {
    Collect sink(margin, found_);
    if (surface_of(pair) != nullptr) {
      list_on_surface(pair, v, at, sink);
    } else {
      const Sides sides = sides_of_witness(v, witness);
      n = sides.n_W;
      OfUnion of_union(*this, pair, at, v, n, sink);
      list_candidates(v, sides, false, near_, of_union);
      // A shape that lies across all of another one touches it at such crossings alone.
      if (found_.empty() && seams_.any(pair)) list_candidates(v, sides, false, near_, sink);
    }
    // A feature along whose normal the shapes overlap much more lies to the side: they part along the witness's.
    const double deepest = kOverlap * std::min(0.0, witness.gap) - kSameOverlap;
    found_.erase(std::remove_if(found_.begin(), found_.end(), [&](const Candidate& c) { return c.gap < deepest; }),
                 found_.end());
    double least = kInfinity;
    for (const Candidate& c : found_) least = std::min(least, c.gap);
    // The nearest features of the pair are none of the listed ones: coal's point represents them.
    if (witness.gap < least - noise(pair)) found_.insert(found_.begin(), nearest);
    if (left != nullptr && !left->empty() && take_out(*left)) found_.push_back(nearest);
  } else {
    found_.push_back(nearest);
  }
  const std::vector<int>& chosen = selection_.choose(found_, n, max_points_);
  const auto made = [&](const Candidate& c) {
    return has_common_normals(pair) && c.feature != 0 ? listed_point(pair, at, c.feature) : make_point(pair, v, c, n);
  };
  for (int i : chosen) points.push_back(made(found_[i]));
  if (others == nullptr || chosen.size() == found_.size()) return;
  for (int i = 0; i < static_cast<int>(found_.size()); ++i)
    if (found_[i].feature != 0 && !std::binary_search(chosen.begin(), chosen.end(), i))
      others->push_back(made(found_[i]));
}

// Takes features out of those that were found, and leaves in the list those that were. True where none is left.
bool Manifolds::take_out(std::vector<std::int64_t>& features) {
  const auto is_found = [this](std::int64_t f) {
    return std::any_of(found_.begin(), found_.end(), [f](const Candidate& c) { return c.feature == f; });
  };
  features.erase(std::remove_if(features.begin(), features.end(), [&](std::int64_t f) { return !is_found(f); }),
                 features.end());
  const auto is_out = [&features](const Candidate& c) {
    return std::find(features.begin(), features.end(), c.feature) != features.end();
  };
  found_.erase(std::remove_if(found_.begin(), found_.end(), is_out), found_.end());
  return found_.empty();
}

double Manifolds::next_gap(int pair, const Placements& at, const ContactPoint* const* persistent, int count,
                           const Contact* witness, double enough, Contact& contact) {
  if (is_single(pair)) return kInfinity;
  const PairView v = view(pair, at);
  if (surface_of(pair) != nullptr) return next_gap_on_surface(pair, at, v, persistent, count, enough, contact);
  const ContactPoint* known = nullptr;
  for (int i = 0; i < count && known == nullptr; ++i)
    if (persistent[i]->feature != 0) known = persistent[i];
  const Sides sides = known != nullptr ? sides_of_point(v, *known, at) : sides_of_witness(v, *witness);
  Least least(*this, pair, at, persistent, count, enough);
  OfUnion of_union(*this, pair, at, v, sides.n_W, least);
  list_candidates(v, sides, true, near_, of_union);
  double value = least.value();
  if (value < kInfinity) evaluate(make_point(pair, v, least.best, sides.n_W), at, contact);
  for (int i = 0; i < count; ++i) {
    if (persistent[i]->kind != PointKind::kRim) continue;
    Contact far;
    const double gap = far_of_rim(*persistent[i], at, far);
    if (gap >= value) continue;
    value = gap;
    contact = far;
  }
  if (count == 0 || witness == nullptr) return value;
  return include_witness(pair, at, persistent, count, *witness, value, contact);
}

double Manifolds::next_gap_on_surface(int pair, const Placements& at, const PairView& v,
                                      const ContactPoint* const* persistent, int count, double enough,
                                      Contact& contact) {
  Least least(*this, pair, at, persistent, count, enough);
  list_on_surface(pair, v, at, least);
  for (const SurfaceFoot& foot : feet_) {
    if (std::isfinite(foot.distance)) continue;
    contact.gap = foot.distance;
    return foot.distance;
  }
  double value = least.value();
  const bool solids = has_common_normals(pair);
  if (value < kInfinity)
    evaluate(solids ? listed_point(pair, at, least.best.feature) : make_point(pair, v, least.best, Vec3::Zero()), at,
             contact);
  if (!solids) return value;
  if (common_normals_.empty() && beside_.gap < kInfinity) {
    const SolidPair shapes(*scene_, pair, at);
    const ContactPoint none = make_solids_point(pair, shapes, 0, beside_);
    set_contact(none, shapes.first_pose().R * beside_.normal, shapes.first_pose().point(beside_.second), beside_.gap,
                contact);
    return beside_.gap < enough ? beside_.gap : kInfinity;
  }
  for (int i = 0; i < count; ++i) {
    Contact far;
    const double gap = far_on_surface(*persistent[i], at, far);
    if (gap >= value) continue;
    value = gap;
    contact = far;
  }
  return value;
}

double Manifolds::deepest(const ContactPoint* const* points, int count, const Placements& at) const {
  double least = 0.0;
  for (int i = 0; i < count; ++i) {
    if (points[i]->kind == PointKind::kWitness || points[i]->kind == PointKind::kLimit) return kInfinity;
    Contact c;
    evaluate(*points[i], at, c);
    least = std::min(least, c.gap);
  }
  return least;
}

bool Manifolds::none_deeper(int pair, const Placements& at, const ContactPoint* const* persistent, int count) const {
  if (count == 0 || is_single(pair)) return false;
  if (surface_of(pair) != nullptr) return true;  // all of its vertices are looked at
  const double least = deepest(persistent, count, at);
  if (least == kInfinity) return false;
  Contact contact;
  evaluate(*persistent[0], at, contact);
  return gap_along(pair, at, contact.normal) - least >= -kDeeper * noise(pair);
}

double Manifolds::crossing_of(int pair, const Placements& at, const ContactPoint* const* persistent, int count) const {
  if (is_single(pair) || surface_of(pair) != nullptr) return 0.0;
  return contactvi::crossing_of(view(pair, at), persistent, count);
}

bool Manifolds::others_behind(int pair, const Placements& at, const ContactPoint* const* persistent, int count,
                              const Behind& by) const {
  return contactvi::others_behind(view(pair, at), persistent, count, by);
}

bool Manifolds::nearest_of_points(int pair, const Placements& at, const ContactPoint* const* persistent, int count,
                                  Contact& contact) const {
  const Behind by{0.0, kSameDistance};
  if (crossing_of(pair, at, persistent, count) == 0.0 || !others_behind(pair, at, persistent, count, by)) return false;
  contact.gap = kInfinity;
  for (int k = 0; k < count; ++k) {
    Contact own;
    evaluate(*persistent[k], at, own);
    if (!valid(*persistent[k], at)) return false;
    if (own.gap < contact.gap) contact = own;
  }
  return true;
}

// Where coal's distance is deeper than the persistent points, a feature has closed that the faces do not list: coal's
// point then gives the gap.
double Manifolds::include_witness(int pair, const Placements& at, const ContactPoint* const* persistent, int count,
                                  const Contact& witness, double value, Contact& contact) const {
  const double noise = this->noise(pair);
  const double least = deepest(persistent, count, at);
  if (least == kInfinity) return value;
  const double deeper = witness.gap - least;
  if (!(deeper < -kDeeper * noise) || deeper + kBelow * noise >= value) return value;
  contact = witness;
  return deeper + kBelow * noise;
}

bool Manifolds::has_lines(int pair) const {
  return features(pair, scene_->pairs[pair].a).edges.size() == 1 &&
         features(pair, scene_->pairs[pair].b).edges.size() == 1;
}

bool Manifolds::has_rims(int pair) const {
  return !features(pair, scene_->pairs[pair].a).rims.empty() || !features(pair, scene_->pairs[pair].b).rims.empty();
}

bool Manifolds::nearest(int pair, const Placements& at, Contact& contact) {
  const Pair& p = scene_->pairs[pair];
  const ShapeFeatures &a = features(pair, p.a), &b = features(pair, p.b);
  if (has_capsules(pair)) {
    const PairView v = view(pair, at);
    nearest_on_lines(line_of(a, v.pose_a, 0), line_of(b, v.pose_b, 0), contact.point_a, contact.point_b);
    const Vec3 apart = contact.point_b - contact.point_a;
    const double distance = apart.norm();
    contact.normal = distance > 0.0 ? Vec3(apart / distance) : any_tangent(v.pose_a.R * a.edges[0].direction);
    contact.point_a += a.radius * contact.normal;
    contact.point_b -= b.radius * contact.normal;
    contact.gap = distance - a.radius - b.radius;
    contact.body_a = v.body_a;
    contact.body_b = v.body_b;
    return true;
  }
  if (is_single(pair) || !(a.is_unbounded() || b.is_unbounded())) return false;
  const Contact none{};
  next_gap(pair, at, nullptr, 0, &none, kInfinity, contact);
  return true;
}

double Manifolds::gap_along(int pair, const Placements& at, const Vec3& n_W) const {
  const PairView v = view(pair, at);
  return contactvi::gap_along(*v.a, v.pose_a, *v.b, v.pose_b, n_W);
}

bool Manifolds::refine(int pair, const Placements& at, Contact& contact) const {
  const PairView v = view(pair, at);
  return refine_nearest(*v.a, v.pose_a, *v.b, v.pose_b, contact);
}

// --- one contact point: from its feature to its data, its gap, and whether its feature still touches ---

void set_rim(const ShapeFeatures::Rim& rim, ContactPoint& p) {
  p.center_B = rim.center;
  p.axis_B = rim.axis;
  p.rim_radius = rim.radius;
}

ContactPoint Manifolds::make_point(int pair, const PairView& v, const Candidate& c, const Vec3& n_W) const {
  ContactPoint p{};
  p.guard = pair;
  p.feature = c.feature;
  p.kind = PointKind::kWitness;
  p.on_b = true;
  p.point_body = v.body_b;
  p.plane_body = v.body_a;
  const Feature kind = feature_kind(c.feature);
  if (kind == Feature::kWitness) return p;
  if (kind == Feature::kEdges) {
    const ShapeFeatures::Edge &a = v.a->edges[feature_i(c.feature)], &b = v.b->edges[feature_j(c.feature)];
    p.kind = PointKind::kEdge;
    p.center_B = b.start;
    p.radius = v.b->radius + b.radius;
    p.origin_B = a.start;
    p.normal_B = a.direction;
    p.offset = v.a->radius + a.radius;
    const Vec3 cross = (v.pose_a.R * a.direction).cross(v.pose_b.R * b.direction);
    p.axis_B = cross.dot(n_W) < 0.0 ? Vec3(-b.direction) : b.direction;
    return p;
  }
  const Parts parts = parts_of(v, c.feature);
  p.on_b = parts.on_b;
  p.point_body = parts.on_b ? v.body_b : v.body_a;
  p.plane_body = parts.on_b ? v.body_a : v.body_b;
  if (is_end(kind) || is_rim_line(kind)) {
    const ShapeFeatures::Edge& over = parts.plane->edges[feature_j(c.feature)];
    const int i = feature_i(c.feature);
    p.kind = is_end(kind) ? PointKind::kEnd : PointKind::kRimLine;
    p.radius = parts.other->radius;
    p.origin_B = over.start;
    p.normal_B = over.direction;
    p.offset = parts.plane->radius + over.radius;
    if (is_end(kind)) {
      const ShapeFeatures::Edge& of = parts.other->edges[i / 2];
      p.center_B = of.start + (i % 2 == 0 ? 0.0 : of.length) * of.direction;
    } else {
      set_rim(parts.other->rims[i / 2], p);
      const Vec3 from = parts.other_pose->into(c.x_W) - p.center_B;
      p.far_B = p.center_B + p.rim_radius * (from - from.dot(p.axis_B) * p.axis_B).normalized();
    }
    return p;
  }
  const ShapeFeatures::Face& face = parts.plane->faces[parts.face];
  p.kind = PointKind::kVertex;
  p.radius = parts.other->radius;
  p.normal_B = face.normal;
  p.offset = face.offset + parts.plane->radius;
  p.material = p.radius == 0.0;
  if (kind == Feature::kRimA || kind == Feature::kRimB) {
    const ShapeFeatures::Rim& rim = parts.other->rims[parts.rim];
    p.kind = PointKind::kRim;
    p.material = false;
    set_rim(rim, p);
    const Vec3 n = parts.other_pose->R.transpose() * (parts.plane_pose->R * face.normal);
    p.far_B = lowest_of_rim(rim.center, rim.axis, rim.radius, -n);
  } else if (kind == Feature::kRimPointA || kind == Feature::kRimPointB) {
    p.center_B = rim_point(parts.other->rims[parts.rim], parts.i % kRimPoints);
  } else if (kind == Feature::kRimSideA || kind == Feature::kRimSideB) {
    p.center_B = parts.other_pose->into(c.x_W);
  } else {
    p.center_B = parts.other->vertices[parts.i];
  }
  if (surface_of(pair) == nullptr) return p;
  p.kind = PointKind::kSurface;
  p.far_B = parts.plane_pose->into(c.x_W);
  p.material = false;
  p.normal_B.setZero();
  p.offset = 0.0;
  return p;
}

ContactPoint Manifolds::point(int pair, const Placements& at, const Contact& witness, std::int64_t feature) const {
  if (has_common_normals(pair) && feature != 0) return listed_point(pair, at, feature);
  const Candidate named{feature, 0.0, 0.5 * (witness.point_a + witness.point_b)};
  // Of several feet the one of this number, where it is now.
  for (const KnownFoot& known : known_feet_) {
    if (known.pair != pair || known.feature != feature) continue;
    const Pose surface = pose_of_surface(*surface_of(pair), at);
    return make_point(pair, view(pair, at), {feature, 0.0, surface.point(known.place)}, witness.normal);
  }
  return make_point(pair, view(pair, at), named, witness.normal);
}

void Manifolds::evaluate(const ContactPoint& point, const Placements& at, Contact& contact) const {
  if (point.kind == PointKind::kVertex) {
    vertex_gap(point, point.center_B, at, contact);
  } else if (point.kind == PointKind::kRim) {
    rim_gap(point, at, contact);
  } else if (point.kind == PointKind::kEnd) {
    end_gap(point, at, contact);
  } else if (point.kind == PointKind::kRimLine) {
    rim_line_gap(point, at, contact);
  } else if (point.kind == PointKind::kSurface) {
    surface_gap(point, at, contact);
  } else if (point.kind == PointKind::kSolids) {
    solids_gap(point, at, contact);
  } else {
    edge_gap(point, at, contact);
  }
}

bool Manifolds::valid(const ContactPoint& point, const Placements& at) const {
  if (point.feature == 0) return true;
  if (point.kind == PointKind::kSolids) return depth_in_part(point, at) >= -kStay * kBorder && !has_merged(point, at);
  const PairView v = view(point.guard, at);
  if (point.kind == PointKind::kEdge) {
    Contact contact;
    evaluate(point, at, contact);
    const int i = feature_i(point.feature), j = feature_j(point.feature);
    const double border = kStay * kBorder;
    Crossing c;
    return cross_lines(line_of(*v.a, v.pose_a, i), line_of(*v.b, v.pose_b, j), contact.normal, border, c) &&
           c.beyond <= border && outside_cone(v, i, j, c.normal) <= kStay * kNormalCone;
  }
  if (point.kind == PointKind::kEnd || point.kind == PointKind::kRimLine) return is_over_line(v, point.feature);
  const Parts parts = parts_of(v, point.feature);
  const ShapeFeatures::Face& face = parts.plane->faces[parts.face];
  if (parts.rim >= 0) {
    const ShapeFeatures::Rim& rim = parts.other->rims[parts.rim];
    const double tilt = rim_tilt(rim.radius, parts.other_pose->R * rim.axis, parts.plane_pose->R * face.normal);
    if (point.kind == PointKind::kRim && kStay * tilt <= kUpright) return false;
    if (point.kind == PointKind::kVertex && tilt > kStay * kUpright) return false;
  }
  return is_over(parts, point, at);
}

double Manifolds::inside_face(const ContactPoint& point, const Placements& at) const {
  if (point.kind == PointKind::kSolids) return depth_in_part(point, at);
  if (point.feature == 0 || (point.kind != PointKind::kVertex && point.kind != PointKind::kRim))
    return std::numeric_limits<double>::infinity();
  const PairView v = view(point.guard, at);
  return inside(parts_of(v, point.feature), point, at);
}

bool Manifolds::is_over_face(const ContactPoint& point, const Placements& at) const {
  const PairView v = view(point.guard, at);
  return is_over(parts_of(v, point.feature), point, at);
}

// Gap of the point of a rim that was farthest from the plane, as long as the rim is nearly flat; infinite otherwise. It
// falls to zero but not below where the rim falls flat: therefore the slack is subtracted.
double Manifolds::far_of_rim(const ContactPoint& point, const Placements& at, Contact& contact) {
  const Vec3 axis = turned_W(at, point.point_body, point.axis_B);
  const Vec3 n = turned_W(at, point.plane_body, point.normal_B);
  if (axis.cross(n).norm() > kNearlyFlat) return std::numeric_limits<double>::infinity();
  return vertex_gap(point, point.far_B, at, contact) - kFarSlack;
}

void Manifolds::update_moving(ContactPoint& point, const Placements& at) {
  if (point.kind == PointKind::kSolids) return move_on_solids(point, at);
  if (point.kind == PointKind::kSurface && has_feet(point.guard)) {
    Contact contact;
    evaluate(point, at, contact);
    point.far_B = point_B(at, point.plane_body, point.on_b ? contact.point_a : contact.point_b);
    for (KnownFoot& known : known_feet_)
      if (known.pair == point.guard && known.feature == point.feature)
        known.place = in_surface(*surface_of(point.guard), point.far_B);
  }
  if (point.kind == PointKind::kRimLine) {
    Vec3 apart;
    point.far_B = point_B(at, point.point_body, rim_line_point(point, at, apart));
  }
  if (point.kind != PointKind::kRim) return;
  const Vec3 n = turned_B(at, point.point_body, turned_W(at, point.plane_body, point.normal_B));
  point.far_B = lowest_of_rim(point.center_B, point.axis_B, point.rim_radius, -n);
}

void Manifolds::find_ends(int pair, const Placements& at, double margin, std::vector<ContactPoint>& points) {
  if (!has_lines(pair)) return;
  const PairView v = view(pair, at);
  found_.clear();
  Collect sink(margin, found_);
  list_line_ends(v, 0, line_of(*v.a, v.pose_a, 0), 0, line_of(*v.b, v.pose_b, 0), true, sink);
  for (const Candidate& c : found_) points.push_back(make_point(pair, v, c, Vec3::Zero()));
}

// Where the one point of two axes lies between their ends and may run along them as the bodies turn, the point of b
// over the axis of a.
ContactPoint Manifolds::frozen_on_lines(const ContactPoint& point, const Placements& at, const Contact& contact,
                                        double turn, double moved) const {
  const PairView v = view(point.guard, at);
  const Line a = line_of(*v.a, v.pose_a, 0), b = line_of(*v.b, v.pose_b, 0);
  const double s = (contact.point_a - a.start).dot(a.direction), t = (contact.point_b - b.start).dot(b.direction);
  const double square = a.direction.cross(b.direction).squaredNorm(), radii = a.radius + b.radius;
  const bool between = s > kBorder && s < a.length - kBorder && t > kBorder && t < b.length - kBorder;
  const double length = std::min(a.length, b.length);
  if (!between || (turn + moved / length) * radii <= kMostRun * length * square) return point;
  ContactPoint p = point;
  p.kind = PointKind::kEnd;
  p.on_b = true;
  p.point_body = v.body_b;
  p.plane_body = v.body_a;
  p.center_B = v.pose_b.into(b.start + t * b.direction);
  p.radius = b.radius;
  p.origin_B = v.a->edges[0].start;
  p.normal_B = v.a->edges[0].direction;
  p.offset = a.radius;
  return p;
}

ContactPoint Manifolds::frozen(const ContactPoint& point, const Placements& at, const Contact& witness, double turn,
                               double moved) const {
  ContactPoint p = point;
  if (point.kind == PointKind::kRim) {
    const Vec3 n = turned_B(at, point.point_body, turned_W(at, point.plane_body, point.normal_B));
    p.kind = PointKind::kVertex;
    p.center_B = lowest_of_rim(point.center_B, point.axis_B, point.rim_radius, n);
  } else if (point.kind == PointKind::kWitness && has_lines(point.guard)) {
    p = frozen_on_lines(point, at, witness, turn, moved);
    if (p.kind == PointKind::kWitness && !has_capsules(point.guard)) make_material(p, at, witness);
  } else if (point.kind == PointKind::kWitness && !is_single(point.guard)) {
    make_material(p, at, witness);
  } else if (point.kind == PointKind::kEdge && has_lines(point.guard)) {
    Contact crossing;
    edge_gap(point, at, crossing);
    p = frozen_on_lines(point, at, crossing, turn, moved);
  } else if (point.kind == PointKind::kEdge) {
    const Vec3 a = turned_W(at, point.plane_body, point.normal_B), b = turned_W(at, point.point_body, point.axis_B);
    if (a.cross(b).norm() > turn) return p;
    Contact crossing;
    edge_gap(point, at, crossing);
    make_material(p, at, crossing);
  }
  return p;
}

Eigen::Vector2d Manifolds::place_along(const ContactPoint& point, const Placements& at, const Contact& contact) const {
  const bool crossing = point.kind == PointKind::kEdge;
  if (!crossing && !(point.kind == PointKind::kWitness && has_lines(point.guard))) return Eigen::Vector2d::Zero();
  const PairView v = view(point.guard, at);
  const auto [i, j] = crossing ? edges_of(point.feature) : std::array<int, 2>{0, 0};
  const ShapeFeatures::Edge &a = v.a->edges[i], &b = v.b->edges[j];
  return {(v.pose_a.into(contact.point_a) - a.start).dot(a.direction),
          (v.pose_b.into(contact.point_b) - b.start).dot(b.direction)};
}

double Manifolds::run(const ContactPoint& point, const Eigen::Vector2d& from, const Eigen::Vector2d& to) const {
  const double least = (to - from).cwiseAbs().minCoeff();
  if (least == 0.0) return 0.0;
  const auto [i, j] = point.kind == PointKind::kEdge ? edges_of(point.feature) : std::array<int, 2>{0, 0};
  const Pair& pair = scene_->pairs[point.guard];
  return least / std::min(features(point.guard, pair.a).edges[i].length, features(point.guard, pair.b).edges[j].length);
}

Vec3 Manifolds::side_of_rim(const ContactPoint& point, const Placements& at) {
  if (point.kind != PointKind::kRim) return Vec3::Zero();
  const Vec3 axis = turned_W(at, point.point_body, point.axis_B), n = turned_W(at, point.plane_body, point.normal_B);
  return (n.dot(axis) * axis - n).normalized();
}

Sides Manifolds::sides_of_point(const PairView& v, const ContactPoint& point, const Placements& at) const {
  Contact contact;
  evaluate(point, at, contact);
  Sides s;
  s.n_W = contact.normal;
  if (point.kind == PointKind::kEdge || point.kind == PointKind::kEnd || point.kind == PointKind::kRimLine) {
    const auto [i, j] = edges_of(point.feature);
    const ShapeFeatures::Edge &a = v.a->edges[i], &b = v.b->edges[j];
    s.a = most_facing(*v.a, v.pose_a, s.n_W, std::array<int, 2>{a.left, a.right});
    s.b = most_facing(*v.b, v.pose_b, -s.n_W, std::array<int, 2>{b.left, b.right});
    // The end of a cylinder has the number of its rim.
    if (point.kind == PointKind::kRimLine) (point.on_b ? s.b : s.a) = feature_i(point.feature) / 2;
    return s;
  }
  const Parts parts = parts_of(v, point.feature);
  (parts.on_b ? s.a : s.b) = parts.face;
  if (parts.plane->is_unbounded()) return s;
  int& across = parts.on_b ? s.b : s.a;
  // A cylinder's faces are numbered like its rims.
  across = parts.rim;
  if (parts.rim < 0) {
    const Vec3 n = parts.on_b ? Vec3(-s.n_W) : s.n_W;
    across = most_facing(*parts.other, *parts.other_pose, n, parts.other->vertex_faces[parts.i]);
  }
  return s;
}

}  // namespace contactvi

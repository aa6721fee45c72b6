// One contact point: from its feature to its data, its gap, whether it still is the feature that touches.
#include <array>
#include <limits>

#include "geometry/manifold.hpp"

namespace contactvi {

namespace {

// From this tilt [rad] on, the far side of a rim that rolls cannot come down before the point is looked for again.
constexpr double kNearlyFlat = 0.1;
// The far side of a rim counts as down this much early [m]: less than what counts as touching, or it would not be
// found.
constexpr double kFarSlack = 5e-12;
// How much beyond the limits of find a point stays valid, so that what was just found is.
constexpr double kStay = 2.0;

// What a feature number means for a pair: `other` lies over face `face` of `plane`.
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
  p.face = is_side ? p.plane->ring_face[feature_j(n) / 2] : feature_j(n);
  p.rim = feature_rim(n);
  return p;
}

// That one of some faces which looks most along n, -1: none of them does.
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

void set_contact(const ContactPoint& p, const Vec3& n, const Vec3& lowest, double gap, Contact& contact) {
  const Vec3 on_other = lowest - p.radius * n, on_plane = on_other - gap * n;
  contact.gap = gap;
  contact.normal = p.on_b ? n : Vec3(-n);
  contact.point_a = p.on_b ? on_plane : on_other;
  contact.point_b = p.on_b ? on_other : on_plane;
  contact.body_a = p.on_b ? p.plane_body : p.point_body;
  contact.body_b = p.on_b ? p.point_body : p.plane_body;
}

// Of a point fixed to point_body, swept by the radius.
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

}  // namespace

ContactPoint Manifolds::make_point(int pair, const PairView& v, const Candidate& c, const Vec3& n_W) const {
  ContactPoint p{};
  p.guard = pair;
  p.feature = c.feature;
  p.kind = PointKind::kWitness;
  p.on_b = true;
  p.point_body = v.b->body;
  p.plane_body = v.a->body;
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
  const ShapeFeatures::Face& face = parts.plane->faces[parts.face];
  p.kind = PointKind::kVertex;
  p.on_b = parts.on_b;
  p.point_body = parts.other->body;
  p.plane_body = parts.plane->body;
  p.radius = parts.other->radius;
  p.normal_B = face.normal;
  p.offset = face.offset + parts.plane->radius;
  p.material = p.radius == 0.0;
  if (kind == Feature::kRimA || kind == Feature::kRimB) {
    const ShapeFeatures::Rim& rim = parts.other->rims[parts.rim];
    p.kind = PointKind::kRim;
    p.material = false;
    p.center_B = rim.center;
    p.axis_B = rim.axis;
    p.rim_radius = rim.radius;
    const Vec3 n = parts.other_pose->R.transpose() * (parts.plane_pose->R * face.normal);
    p.far_B = lowest_of_rim(rim.center, rim.axis, rim.radius, -n);
  } else if (kind == Feature::kRimPointA || kind == Feature::kRimPointB) {
    p.center_B = rim_point(parts.other->rims[parts.rim], parts.i % kRimPoints);
  } else if (kind == Feature::kRimSideA || kind == Feature::kRimSideB) {
    p.center_B = parts.other_pose->into(c.x_W);
  } else {
    p.center_B = parts.other->vertices[parts.i];
  }
  return p;
}

ContactPoint Manifolds::point(int pair, const Placements& at, const Contact& witness, std::int64_t feature) const {
  return make_point(pair, view(pair, at), {feature, 0.0, Vec3::Zero()}, witness.normal);
}

void Manifolds::evaluate(const ContactPoint& point, const Placements& at, Contact& contact) const {
  if (point.kind == PointKind::kVertex) {
    vertex_gap(point, point.center_B, at, contact);
  } else if (point.kind == PointKind::kRim) {
    rim_gap(point, at, contact);
  } else {
    edge_gap(point, at, contact);
  }
}

bool Manifolds::valid(const ContactPoint& point, const Placements& at) const {
  if (point.feature == 0) return true;
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
  const Parts parts = parts_of(v, point.feature);
  const ShapeFeatures::Face& face = parts.plane->faces[parts.face];
  if (parts.rim >= 0) {
    const ShapeFeatures::Rim& rim = parts.other->rims[parts.rim];
    const double tilt = rim_tilt(rim.radius, parts.other_pose->R * rim.axis, parts.plane_pose->R * face.normal);
    if (point.kind == PointKind::kRim && kStay * tilt <= kUpright) return false;
    if (point.kind == PointKind::kVertex && tilt > kStay * kUpright) return false;
  }
  if (parts.plane->is_unbounded()) return true;
  Vec3 x = point_W(at, point.point_body, point.center_B);
  if (point.kind == PointKind::kRim) {
    const Vec3 n = parts.plane_pose->R * face.normal;
    x = lowest_of_rim(x, turned_W(at, point.point_body, point.axis_B), point.rim_radius, n);
  }
  return outside_of(*parts.plane, face, parts.plane_pose->into(x)) <= kStay * kBorder;
}

// Gap of the point of a rim that was farthest from the plane, as long as the rim is nearly flat. It comes down to
// zero and no further where the rim falls flat, hence less the slack.
double Manifolds::far_of_rim(const ContactPoint& point, const Placements& at, Contact& contact) {
  const Vec3 axis = turned_W(at, point.point_body, point.axis_B);
  const Vec3 n = turned_W(at, point.plane_body, point.normal_B);
  if (axis.cross(n).norm() > kNearlyFlat) return std::numeric_limits<double>::infinity();
  return vertex_gap(point, point.far_B, at, contact) - kFarSlack;
}

void Manifolds::renew(ContactPoint& point, const Placements& at) const {
  if (point.kind != PointKind::kRim) return;
  const Vec3 n_W = turned_W(at, point.plane_body, point.normal_B);
  const Vec3 n = point.point_body < 0 ? n_W : Vec3(at.R_W[point.point_body].transpose() * n_W);
  point.far_B = lowest_of_rim(point.center_B, point.axis_B, point.rim_radius, -n);
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
  if (point.kind == PointKind::kEdge) {
    const ShapeFeatures::Edge& a = v.a->edges[feature_i(point.feature)];
    const ShapeFeatures::Edge& b = v.b->edges[feature_j(point.feature)];
    s.a = most_facing(*v.a, v.pose_a, s.n_W, std::array<int, 2>{a.left, a.right});
    s.b = most_facing(*v.b, v.pose_b, -s.n_W, std::array<int, 2>{b.left, b.right});
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

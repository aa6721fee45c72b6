#include "geometry/nearest_features.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace contactvi {

namespace {

constexpr double kCertified = 2e-13;  // [m] per metre of the places: distance and bound differ by rounding
constexpr double kOnFeature = 1e-5;   // [m] coal's point is this near to a feature that is tried first
constexpr double kFlat = 1e-3;        // [rad] from here on a disc or a side of a cylinder is tried first
constexpr double kFacingSide = 0.05;  // [rad] of a face to the normal, for it to be tried
constexpr int kNewton = 12;
constexpr double kStep = 1e-15;  // of the size: Newton's method has converged

// A feature of one shape in the world: a point, a line, a circle, or a plane.
struct Piece {
  enum Kind : std::uint8_t { kPoint, kLine, kCircle, kPlane };
  Kind kind;
  Vec3 origin;    // point; start of the line; centre of the circle; point on the plane
  Vec3 u, w;      // direction of the line; of the circle: the unit vectors of its angle; normal of the plane: u
  double radius;  // of the circle
  double length;  // of the line
  double swept;   // the piece is swept by this, besides the shape's own radius
  double start;   // parameter at coal's point
  int face;       // of a plane
};

// The pieces of a shape near coal's point, in the order in which they are tried.
struct Pieces {
  std::array<Piece, 5> list;
  int count = 0;
  void add(const Piece& p) { list[count++] = p; }
};

Vec3 into(const Pose& pose, const Vec3& n_W) { return pose.R.transpose() * n_W; }

bool is_cylinder(const ShapeFeatures& o) { return !o.rims.empty(); }

// The point of the core that lies farthest along m, both in the shape's frame.
Vec3 support(const ShapeFeatures& o, const Vec3& m, int* vertex = nullptr) {
  if (is_cylinder(o)) {
    const ShapeFeatures::Rim& rim = m.dot(o.rims[0].axis) >= 0.0 ? o.rims[0] : o.rims[1];
    return lowest_of_rim(rim.center, rim.axis, rim.radius, -m);
  }
  int best = 0;
  double most = -INFINITY;
  for (int i = 0; i < static_cast<int>(o.vertices.size()); ++i) {
    const double along = m.dot(o.vertices[i]);
    if (along <= most) continue;
    most = along;
    best = i;
  }
  if (vertex != nullptr) *vertex = best;
  return o.vertices[best];
}

Piece line_piece(const Pose& pose, const ShapeFeatures::Edge& e, const Vec3& x) {
  return {Piece::kLine,
          pose.point(e.start),
          pose.R * e.direction,
          Vec3::Zero(),
          0.0,
          e.length,
          e.radius,
          (x - e.start).dot(e.direction),
          -1};
}

Piece plane_piece(const Pose& pose, const ShapeFeatures& o, int face) {
  const ShapeFeatures::Face& f = o.faces[face];
  return {Piece::kPlane, pose.point(f.offset * f.normal), pose.R * f.normal, Vec3::Zero(), 0.0, 0.0, 0.0, 0.0, face};
}

// m: outward normal, x: coal's point on the core, both in the cylinder's frame.
void cylinder_pieces(const ShapeFeatures& o, const Pose& pose, const Vec3& m, const Vec3& x, Pieces& pieces) {
  const ShapeFeatures::Edge& axis = o.edges[0];
  const int end = (x - axis.start).dot(axis.direction) > 0.5 * axis.length ? 1 : 0;
  const int near = o.rims[0].axis.dot(axis.direction) > 0.0 ? 1 - end : end;
  const ShapeFeatures::Rim& rim = o.rims[near];
  const double along = m.dot(rim.axis), across = m.cross(rim.axis).norm();
  const Piece side = line_piece(pose, axis, x);
  int disc = -1;
  for (int f = 0; f < static_cast<int>(o.faces.size()); ++f)
    if (o.faces[f].normal.dot(rim.axis) > 0.5) disc = f;
  if (std::abs(along) < kFlat) pieces.add(side);
  if (disc >= 0 && along > 0.0 && across < kFlat) pieces.add(plane_piece(pose, o, disc));
  Vec3 out = x - rim.center - (x - rim.center).dot(rim.axis) * rim.axis;
  if (!(out.norm() > 1e-3 * rim.radius)) out = m - along * rim.axis;
  if (out.norm() > 0.0) {
    const Vec3 u = out.normalized();
    pieces.add({Piece::kCircle, pose.point(rim.center), pose.R * u, pose.R * rim.axis.cross(u), rim.radius, 0.0, 0.0,
                0.0, -1});
  }
  if (disc >= 0 && along > 0.0 && across >= kFlat && across < kFacingSide) pieces.add(plane_piece(pose, o, disc));
  if (std::abs(along) >= kFlat && std::abs(along) < kFacingSide) pieces.add(side);
}

void polytope_pieces(const ShapeFeatures& o, const Pose& pose, const Vec3& m, const Vec3& x, Pieces& pieces) {
  int vertex = 0;
  const Vec3 v = support(o, m, &vertex);
  const Piece point{Piece::kPoint, pose.point(v), Vec3::Zero(), Vec3::Zero(), 0.0, 0.0, 0.0, 0.0, -1};
  int edge = -1;
  double least = INFINITY;
  static const std::vector<int> kNone, kAxis{0};  // of a sphere, of a capsule
  const bool polytope = !o.faces.empty();
  for (int e : polytope ? o.vertex_edges[vertex] : o.edges.empty() ? kNone : kAxis) {
    const Vec3 d = x - o.edges[e].start;
    const double away = (d - d.dot(o.edges[e].direction) * o.edges[e].direction).squaredNorm();
    if (away >= least) continue;
    least = away;
    edge = e;
  }
  int face = -1;
  double most = std::cos(kFacingSide);
  for (int f : polytope ? o.vertex_faces[vertex] : kNone) {
    if (o.faces[f].normal.dot(m) <= most) continue;
    most = o.faces[f].normal.dot(m);
    face = f;
  }
  const bool at_vertex = (x - v).norm() < kOnFeature, at_edge = edge >= 0 && least < kOnFeature * kOnFeature;
  if (at_vertex) pieces.add(point);
  if (at_edge) pieces.add(line_piece(pose, o.edges[edge], x));
  if (face >= 0) pieces.add(plane_piece(pose, o, face));
  if (!at_edge && edge >= 0) pieces.add(line_piece(pose, o.edges[edge], x));
  if (!at_vertex) pieces.add(point);
  if (edge < 0 || at_vertex) return;
  // Where an edge is nearly parallel to the other body its other end may be the nearest one.
  const ShapeFeatures::Edge& e = o.edges[edge];
  pieces.add({Piece::kPoint, pose.point(o.vertices[e.v0 == vertex ? e.v1 : e.v0]), Vec3::Zero(), Vec3::Zero(), 0.0, 0.0,
              0.0, 0.0, -1});
}

// A piece's point at the parameter s, and its first and second derivative.
void point_of(const Piece& p, double s, Vec3& x, Vec3& first, Vec3& second) {
  if (p.kind == Piece::kCircle) {
    const double c = std::cos(s), d = std::sin(s);
    second = -p.radius * (c * p.u + d * p.w);
    first = p.radius * (c * p.w - d * p.u);
    x = p.origin - second;
  } else {
    x = p.origin + s * p.u;
    first = p.u;
    second.setZero();
  }
  if (p.kind == Piece::kPoint) first.setZero();
}

// Newton's method for the nearest points of two pieces that are no planes; false where it does not lead to a minimum
// inside of both.
bool nearest_points(const Piece& a, const Piece& b, Vec3& x_a, Vec3& x_b) {
  double s = a.start, t = b.start;
  Vec3 a1, a2, b1, b2;
  const double unit_a = a.kind == Piece::kPoint ? 1.0 : 0.0, unit_b = b.kind == Piece::kPoint ? 1.0 : 0.0;
  for (int k = 0;; ++k) {
    point_of(a, s, x_a, a1, a2);
    point_of(b, t, x_b, b1, b2);
    const Vec3 d = x_b - x_a;
    const double g_a = -d.dot(a1), g_b = d.dot(b1);
    const double aa = a1.squaredNorm() - d.dot(a2) + unit_a, bb = b1.squaredNorm() + d.dot(b2) + unit_b;
    const double ab = -a1.dot(b1), det = aa * bb - ab * ab;
    if (!(aa > 0.0) || !(det > 1e-12 * aa * bb)) return false;
    const double ds = -(bb * g_a - ab * g_b) / det, dt = -(aa * g_b - ab * g_a) / det;
    const bool converged = std::abs(ds) <= kStep * (1.0 + std::abs(s)) && std::abs(dt) <= kStep * (1.0 + std::abs(t));
    if (converged || k == kNewton) break;
    s += ds;
    t += dt;
  }
  auto is_inside = [](const Piece& p, double at) {
    return p.kind != Piece::kLine || (at >= -kBorder && at <= p.length + kBorder);
  };
  return is_inside(a, s) && is_inside(b, t);
}

// The distance of the cores along the unit vector n from a to b: a lower bound on their distance.
double along_normal(const ShapeFeatures& a, const Pose& pose_a, const ShapeFeatures& b, const Pose& pose_b,
                    const Vec3& n) {
  const Vec3 x_a = pose_a.point(support(a, into(pose_a, n))), x_b = pose_b.point(support(b, into(pose_b, -n)));
  return n.dot(x_b - x_a);
}

// Of the points of `other` that lie lowest over a face, one that is over it; near_W: coal's point of `other`. n_W: the
// face's outward normal. False if there is none.
bool point_over(const ShapeFeatures& plane, const Pose& plane_pose, int face, const ShapeFeatures& other,
                const Pose& other_pose, const Vec3& n_W, const Vec3& near_W, Vec3& x_W) {
  const ShapeFeatures::Face& f = plane.faces[face];
  auto is_over = [&](const Vec3& x) { return outside_of(plane, f, plane_pose.into(x)) <= kBorder; };
  const Vec3 down = into(other_pose, -n_W), lowest = support(other, down);
  x_W = other_pose.point(lowest);
  if (is_over(x_W)) return true;
  const Vec3 near = other_pose.into(near_W);
  if (is_cylinder(other)) {
    const ShapeFeatures::Rim& rim = down.dot(other.rims[0].axis) >= 0.0 ? other.rims[0] : other.rims[1];
    const ShapeFeatures::Edge& axis = other.edges[0];
    if (std::abs(down.dot(axis.direction)) * axis.length <= kUpright) {  // it lies on its side
      const double back = std::clamp((lowest - near).dot(rim.axis), 0.0, axis.length);
      x_W = other_pose.point(lowest - back * rim.axis);
      return is_over(x_W);
    }
    if (rim_tilt(rim.radius, rim.axis, down) > kUpright) return false;
    Vec3 out = near - rim.center;  // it stands
    out -= out.dot(rim.axis) * rim.axis;
    const double length = out.norm();
    x_W = other_pose.point(rim.center + (length > rim.radius ? rim.radius / length : 1.0) * out);
    return is_over(x_W);
  }
  // An edge of a polytope that is parallel to the plane, and reaches beyond the face on both sides.
  const double most = down.dot(lowest);
  const Vec3* ends[2];
  int count = 0;
  for (const Vec3& v : other.vertices) {
    if (down.dot(v) < most - kUpright) continue;
    x_W = other_pose.point(v);
    if (is_over(x_W)) return true;
    if (count < 2) ends[count] = &v;
    ++count;
  }
  if (count != 2) return false;
  const Vec3 along = *ends[1] - *ends[0];
  x_W = other_pose.point(*ends[0] + std::clamp((near - *ends[0]).dot(along) / along.squaredNorm(), 0.0, 1.0) * along);
  return is_over(x_W);
}

}  // namespace

bool is_refinable(const ShapeFeatures& o) { return !o.is_unbounded() && (is_cylinder(o) || !o.vertices.empty()); }

bool refine_nearest(const ShapeFeatures& a, const Pose& pose_a, const ShapeFeatures& b, const Pose& pose_b,
                    Contact& contact) {
  if (!is_refinable(a) || !is_refinable(b)) return false;
  const Vec3 core_a = contact.point_a - a.radius * contact.normal, core_b = contact.point_b + b.radius * contact.normal;
  const double radii = a.radius + b.radius;
  const double rounding = kCertified * (1.0 + core_a.cwiseAbs().maxCoeff());
  auto add_pieces = [](const ShapeFeatures& o, const Pose& pose, const Vec3& n_W, const Vec3& x_W, Pieces& pieces) {
    if (is_cylinder(o)) {
      cylinder_pieces(o, pose, into(pose, n_W), pose.into(x_W), pieces);
    } else {
      polytope_pieces(o, pose, into(pose, n_W), pose.into(x_W), pieces);
    }
  };
  Pieces of_a, of_b;
  add_pieces(a, pose_a, contact.normal, core_a, of_a);
  add_pieces(b, pose_b, -contact.normal, core_b, of_b);
  for (int sum = 0; sum <= of_a.count + of_b.count - 2; ++sum) {
    for (int i = 0; i <= sum && i < of_a.count; ++i) {
      const int j = sum - i;
      if (j >= of_b.count) continue;
      const Piece &p = of_a.list[i], &q = of_b.list[j];
      Vec3 n, x_a, x_b;
      double distance;
      if (p.kind == Piece::kPlane || q.kind == Piece::kPlane) {
        const bool on_a = p.kind == Piece::kPlane;
        n = on_a ? p.u : Vec3(-q.u);
        if (on_a) {
          if (!point_over(a, pose_a, p.face, b, pose_b, n, core_b, x_b)) continue;
          distance = n.dot(x_b - p.origin);
          x_a = x_b - distance * n;
        } else {
          if (!point_over(b, pose_b, q.face, a, pose_a, -n, core_a, x_a)) continue;
          distance = n.dot(q.origin - x_a);
          x_b = x_a + distance * n;
        }
      } else {
        if (!nearest_points(p, q, x_a, x_b)) continue;
        n = x_b - x_a;
        distance = n.norm();
        if (!(distance > 0.0)) continue;
        n /= distance;
        x_a += p.swept * n;
        x_b -= q.swept * n;
        distance -= p.swept + q.swept;
      }
      if (!(distance > 0.0) || distance - along_normal(a, pose_a, b, pose_b, n) > rounding) continue;
      contact.gap = distance - radii;
      contact.normal = n;
      contact.point_a = x_a + a.radius * n;
      contact.point_b = x_b - b.radius * n;
      return true;
    }
  }
  return false;
}

}  // namespace contactvi

#include "geometry/nearest_features.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "geometry/nearest_on_ellipsoid.hpp"

namespace contactvi {

namespace {

constexpr double kCertified = 2e-13;  // [m] per metre of the places: distance and bound differ by rounding
// [m] beyond the border of a face or the end of an edge a point counts as over it. Where the cores are 2e-6 m apart, as
// they are at contact, the distance is then wrong by 2e-14 m.
constexpr double kBeyond = 3e-10;
constexpr double kOnFeature = 1e-5;   // [m] coal's point is this near to a feature that is tried first
constexpr double kFlat = 1e-3;        // [rad] from here on a disc or a side of a cylinder is tried first
constexpr double kFacingSide = 0.05;  // [rad] of a face to the normal, for it to be tried
constexpr double kFlush = 1e-13;      // [m] a side, a disc or an edge whose points differ by less is parallel to a face
constexpr double kParallel = 1e-12;   // square of the sine between a circle and another piece that are parallel
// The same between two lines: where they cross at less, their distance differs by (1e-12 length)^2 / 2e-6 m at most.
constexpr double kParallelLines = 1e-24;
constexpr double kEpsilon = std::numeric_limits<double>::epsilon();
constexpr double kNoise = 1e-6;  // [m] per metre of the places: coal's distances are better
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
  double start;   // of a line: the parameter at coal's point
  int face;       // of a plane
  Eigen::Vector2d angle{1.0, 0.0};  // of a circle: cosine and sine of the angle at coal's point
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
  const int best = farthest_vertex(o, m);
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

// out: unit vector across the axis, from which the angle counts.
Piece circle_piece(const Pose& pose, const ShapeFeatures::Rim& rim, const Vec3& out) {
  return {Piece::kCircle,
          pose.point(rim.center),
          pose.R * out,
          pose.R * rim.axis.cross(out),
          rim.radius,
          0.0,
          0.0,
          0.0,
          -1};
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
  if (out.norm() > 0.0) pieces.add(circle_piece(pose, rim, out.normalized()));
  // Where the side is nearly parallel to the other body the other rim may be the nearest one.
  if (out.norm() > 0.0 && std::abs(along) < kFlat) pieces.add(circle_piece(pose, o.rims[1 - near], out.normalized()));
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
  const bool at_vertex = (x - v).norm() < kOnFeature;
  for (int e : polytope ? o.vertex_edges[vertex] : o.edges.empty() ? kNone : kAxis) {
    const Vec3 d = x - o.edges[e].start;
    // Of several edges at a vertex the one that is nearly parallel to the other body.
    const double away = at_vertex ? kOnFeature * kOnFeature * std::abs(o.edges[e].direction.dot(m))
                                  : (d - d.dot(o.edges[e].direction) * o.edges[e].direction).squaredNorm();
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
  const bool at_edge = edge >= 0 && least < kOnFeature * kOnFeature;
  if (at_vertex) pieces.add(point);
  if (at_edge) pieces.add(line_piece(pose, o.edges[edge], x));
  if (face >= 0) pieces.add(plane_piece(pose, o, face));
  if (!at_edge && edge >= 0) pieces.add(line_piece(pose, o.edges[edge], x));
  if (!at_vertex) pieces.add(point);
  if (edge < 0 || (at_vertex && std::abs(o.edges[edge].direction.dot(m)) > kFlat)) return;
  // Where an edge is nearly parallel to the other body its other end may be the nearest one.
  const ShapeFeatures::Edge& e = o.edges[edge];
  pieces.add({Piece::kPoint, pose.point(o.vertices[e.v0 == vertex ? e.v1 : e.v0]), Vec3::Zero(), Vec3::Zero(), 0.0, 0.0,
              0.0, 0.0, -1});
}

// A point that moves on a piece: place, first and second derivative. Angles are unit vectors, because the sine of the C
// library is another one on other processors.
struct Runner {
  const Piece* piece;
  double s = 0.0;
  Eigen::Vector2d angle{1.0, 0.0};
  Vec3 x{}, first{}, second{};

  explicit Runner(const Piece& p) : piece(&p), s(p.start), angle(p.angle) { place(); }

  void place() {
    if (piece->kind == Piece::kCircle) {
      second = -piece->radius * (angle[0] * piece->u + angle[1] * piece->w);
      first = piece->radius * (angle[0] * piece->w - angle[1] * piece->u);
      x = piece->origin - second;
      return;
    }
    x = piece->origin + s * piece->u;  // of a point u is zero
    first = piece->u;
    second.setZero();
  }

  void move(double step) {
    s += step;
    angle = Eigen::Vector2d(angle[0] - step * angle[1], angle[1] + step * angle[0]).normalized();
    place();
  }

  bool has_converged(double step) const {
    return std::abs(step) <= kStep * (1.0 + (piece->kind == Piece::kLine ? std::abs(s) : 0.0));
  }

  bool is_inside() const { return piece->kind != Piece::kLine || (s >= -kBeyond && s <= piece->length + kBeyond); }
};

// The nearest points of two pieces that are no planes, and the unit tangents there; that of a point is zero.
struct NearestPoints {
  Vec3 x_a, x_b, t_a, t_b;
};

// Of two lines. False where they are parallel, or are nearest beyond an end.
bool nearest_on_lines(const Piece& p, const Piece& q, NearestPoints& found) {
  const Vec3 cross = p.u.cross(q.u), d = q.origin - p.origin;
  const double square = cross.squaredNorm();
  if (!(square > kParallelLines)) return false;
  Runner a(p), b(q);
  a.s = d.cross(q.u).dot(cross) / square;
  b.s = d.cross(p.u).dot(cross) / square;
  a.place();
  b.place();
  found = {a.x, b.x, p.u, q.u};
  return a.is_inside() && b.is_inside();
}

// By Newton's method, where it does not lead to a minimum inside of both false.
bool nearest_points(const Piece& p, const Piece& q, NearestPoints& found) {
  if (p.kind == Piece::kLine && q.kind == Piece::kLine) return nearest_on_lines(p, q, found);
  Runner a(p), b(q);
  if (p.kind == Piece::kLine && q.kind == Piece::kCircle) a.move(p.u.dot(b.x - a.x));
  if (q.kind == Piece::kLine && p.kind == Piece::kCircle) b.move(q.u.dot(a.x - b.x));
  const double unit_a = p.kind == Piece::kPoint ? 1.0 : 0.0, unit_b = q.kind == Piece::kPoint ? 1.0 : 0.0;
  for (int k = 0;; ++k) {
    const Vec3 d = b.x - a.x;
    const double g_a = -d.dot(a.first), g_b = d.dot(b.first);
    const double aa = a.first.squaredNorm() - d.dot(a.second) + unit_a;
    const double bb = b.first.squaredNorm() + d.dot(b.second) + unit_b;
    const double ab = -a.first.dot(b.first), det = aa * bb - ab * ab;
    if (!(aa > 0.0) || !(det > kParallel * aa * bb)) return false;
    const double step_a = -(bb * g_a - ab * g_b) / det, step_b = -(aa * g_b - ab * g_a) / det;
    if ((a.has_converged(step_a) && b.has_converged(step_b)) || k == kNewton) break;
    a.move(step_a);
    b.move(step_b);
  }
  found = {a.x, b.x, a.first.normalized(), b.first.normalized()};
  return a.is_inside() && b.is_inside();
}

// The common normal of two pieces at their nearest points, directed as d = x_b - x_a. The rounding of the points turns
// d by `turn` [rad], which is much where they are near to each other: therefore the normal is made orthogonal to the
// tangents, whose rounding does not depend on the distance. Of tangents that are nearly parallel, the part of one
// across the other is worse than d itself from a sine of kEpsilon / turn on.
Vec3 common_normal(const NearestPoints& at, double turn) {
  Vec3 n = at.x_b - at.x_a;
  const bool has_a = !at.t_a.isZero(0.0);
  n -= n.dot(at.t_a) * at.t_a;
  Vec3 across = at.t_b - at.t_b.dot(at.t_a) * at.t_a;
  const double sine = across.norm();
  if (sine * turn > kEpsilon || (sine > 0.0 && !has_a)) {
    across /= sine;
    n -= n.dot(across) * across;
  }
  return n.normalized();
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
  auto is_over = [&](const Vec3& x) { return outside_of(plane, f, plane_pose.into(x)) <= kBeyond; };
  const Vec3 down = into(other_pose, -n_W), lowest = support(other, down);
  x_W = other_pose.point(lowest);
  if (is_over(x_W)) return true;
  const Vec3 near = other_pose.into(near_W);
  if (is_cylinder(other)) {
    const ShapeFeatures::Rim& rim = down.dot(other.rims[0].axis) >= 0.0 ? other.rims[0] : other.rims[1];
    const ShapeFeatures::Edge& axis = other.edges[0];
    if (std::abs(down.dot(axis.direction)) * axis.length <= kFlush) {  // it lies on its side
      const double back = std::clamp((lowest - near).dot(rim.axis), 0.0, axis.length);
      x_W = other_pose.point(lowest - back * rim.axis);
      return is_over(x_W);
    }
    if (rim_tilt(rim.radius, rim.axis, down) > kFlush) return false;
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
    if (down.dot(v) < most - kFlush) continue;
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

// The candidates with the least gaps, ascending.
class Lowest final : public CandidateSink {
 public:
  explicit Lowest(double most) { limit = most; }
  void add(const Candidate& c) override {
    int k = std::min(count_, kMost - 1);
    if (count_ == kMost && !(c.gap < list_[k].gap)) return;
    for (; k > 0 && c.gap < list_[k - 1].gap; --k) list_[k] = list_[k - 1];
    list_[k] = c;
    count_ = std::min(count_ + 1, kMost);
  }
  int count() const { return count_; }
  const Candidate& operator[](int k) const { return list_[k]; }

 private:
  static constexpr int kMost = 4;
  std::array<Candidate, kMost> list_{};
  int count_ = 0;
};

// One pair with coal's contact, and the attempts to find its nearest features.
class Refinement {
 public:
  Refinement(const ShapeFeatures& a, const Pose& pose_a, const ShapeFeatures& b, const Pose& pose_b, Contact& contact)
      : a_{&a, &pose_a, contact.point_a - a.radius * contact.normal, {}},
        b_{&b, &pose_b, contact.point_b + b.radius * contact.normal, {}},
        contact_(&contact),
        size_(1.0 + contact.point_a.cwiseAbs().maxCoeff()) {
    add_pieces(a_, contact.normal);
    add_pieces(b_, -contact.normal);
  }

  bool run() {
    const int last = a_.pieces.count + b_.pieces.count - 2;
    for (int sum = 0; sum <= last; ++sum)
      for (int i = std::max(0, sum - b_.pieces.count + 1); i <= sum && i < a_.pieces.count; ++i)
        if (try_pieces(a_.pieces.list[i], b_.pieces.list[sum - i])) return true;
    return try_borders(a_, b_) || try_borders(b_, a_) || try_candidates();
  }

 private:
  struct Body {
    const ShapeFeatures* shape;
    const Pose* pose;
    Vec3 near;  // coal's point on the core, world frame
    Pieces pieces;
  };

  static void add_pieces(Body& body, const Vec3& n_W) {
    const Vec3 m = into(*body.pose, n_W), x = body.pose->into(body.near);
    if (is_cylinder(*body.shape)) {
      cylinder_pieces(*body.shape, *body.pose, m, x, body.pieces);
    } else {
      polytope_pieces(*body.shape, *body.pose, m, x, body.pieces);
    }
  }

  bool try_pieces(const Piece& p, const Piece& q) {
    if (p.kind == Piece::kPlane) return try_plane(a_, p, b_, p.u);
    if (q.kind == Piece::kPlane) return try_plane(b_, q, a_, -q.u);
    return try_curves(p, q);
  }

  // A face of `body` and the lowest point of the other one over it; n: the face's normal, directed from a to b.
  bool try_plane(const Body& body, const Piece& plane, const Body& other, const Vec3& n) {
    Vec3 x;
    if (!point_over(*body.shape, *body.pose, plane.face, *other.shape, *other.pose, plane.u, other.near, x))
      return false;
    const double distance = plane.u.dot(x - plane.origin);
    const Vec3 on_face = x - distance * plane.u;
    return &body == &a_ ? accept(n, distance, on_face, x) : accept(n, distance, x, on_face);
  }

  bool try_curves(const Piece& p, const Piece& q) {
    NearestPoints at;
    if (!nearest_points(p, q, at)) return false;
    const Vec3 d = at.x_b - at.x_a;
    const double length = d.norm();
    if (!(length > 0.0)) return false;
    const Vec3 n = common_normal(at, kEpsilon * size_ / length);
    return accept(n, n.dot(d) - p.swept - q.swept, at.x_a + p.swept * n, at.x_b - q.swept * n);
  }

  // Where a side, an edge or a disc lies flat over a face but for rounding, and its lowest point is not over the face,
  // the nearest points are where it crosses the border of the face in the view along the normal.
  bool try_borders(const Body& body, const Body& other) {
    for (int i = 0; i < body.pieces.count; ++i) {
      if (body.pieces.list[i].kind != Piece::kPlane) continue;
      const ShapeFeatures::Face& face = body.shape->faces[body.pieces.list[i].face];
      for (int k = face.first; k < face.first + face.count; ++k) {
        const Piece edge =
            line_piece(*body.pose, body.shape->edges[body.shape->ring_edge[k]], body.pose->into(body.near));
        if (try_border(body, edge, other)) return true;
      }
      for (const ShapeFeatures::Rim& rim : body.shape->rims)
        if (face.normal.dot(rim.axis) > 0.5 && try_border(body, circle_piece(*body.pose, rim, rim.zero), other))
          return true;
    }
    return false;
  }

  bool try_border(const Body& body, const Piece& border, const Body& other) {
    for (int j = 0; j < other.pieces.count; ++j) {
      const Piece& piece = other.pieces.list[j];
      if (piece.kind != Piece::kLine && piece.kind != Piece::kCircle) continue;
      Piece starts[2][2] = {{border, piece}, {border, piece}};
      if (border.kind == Piece::kCircle) set_crossings(starts[0][0], starts[1][0], piece);
      if (piece.kind == Piece::kCircle) set_crossings(starts[0][1], starts[1][1], border);
      for (const auto& start : starts)
        if (&body == &a_ ? try_curves(start[0], start[1]) : try_curves(start[1], start[0])) return true;
    }
    return false;
  }

  // The two angles of a circle where it crosses another piece in the view along its axis, if it does.
  static void set_crossings(Piece& first, Piece& second, const Piece& other) {
    const Vec3 d = other.origin - first.origin;
    const double x = d.dot(first.u), y = d.dot(first.w);
    Eigen::Vector2d middle;  // direction halfway between the crossings
    double cosine;           // of the angle from there to each of them
    if (other.kind == Piece::kLine) {
      const Eigen::Vector2d along(other.u.dot(first.u), other.u.dot(first.w));
      const double length = along.norm();
      if (!(length > 0.0)) return;
      middle = Eigen::Vector2d(along[1], -along[0]) / length;
      cosine = middle.dot(Eigen::Vector2d(x, y)) / first.radius;
    } else {
      const double apart = std::sqrt(x * x + y * y), r = first.radius;
      if (!(apart > 0.0)) return;
      middle = Eigen::Vector2d(x, y) / apart;
      cosine = (apart * apart + r * r - other.radius * other.radius) / (2.0 * apart * r);
    }
    if (!(std::abs(cosine) <= 1.0)) return;
    const double sine = std::sqrt(1.0 - cosine * cosine);
    const Eigen::Vector2d across(-middle[1], middle[0]);
    first.angle = cosine * middle - sine * across;
    second.angle = cosine * middle + sine * across;
  }

  // Where two faces are nearly flush the nearest points may be anywhere on both, far from coal's: of all vertices and
  // crossings of edges over them the lowest.
  bool try_candidates() {
    const Sides sides{face_of(a_), face_of(b_), contact_->normal};
    if (sides.a < 0 && sides.b < 0) return false;
    const PairView v{a_.shape, b_.shape, *a_.pose, *b_.pose, contact_->body_a, contact_->body_b};
    Lowest lowest(contact_->gap + kNoise);
    NearFeatures near;
    list_candidates(v, sides, false, near, lowest);
    for (int k = 0; k < lowest.count(); ++k)
      if (try_candidate(lowest[k])) return true;
    return false;
  }

  bool try_candidate(const Candidate& c) {
    const Feature kind = feature_kind(c.feature);
    if (is_end(kind) || is_rim_line(kind)) return false;
    const bool on_b = feature_on_b(c.feature);
    const double distance = c.gap + a_.shape->radius + b_.shape->radius;
    if (kind == Feature::kEdges) {
      const ShapeFeatures::Edge &e = a_.shape->edges[feature_i(c.feature)], &f = b_.shape->edges[feature_j(c.feature)];
      Vec3 n = (a_.pose->R * e.direction).cross(b_.pose->R * f.direction).normalized();
      if (n.dot(contact_->normal) < 0.0) n = -n;
      const double between = distance + e.radius + f.radius;
      return accept(n, distance, c.x_W + (e.radius - 0.5 * between) * n, c.x_W + (0.5 * between - f.radius) * n);
    }
    const Body& plane = on_b ? a_ : b_;
    const bool is_side = kind == Feature::kRimSideA || kind == Feature::kRimSideB;
    const int face = is_side ? plane.shape->ring_face[feature_j(c.feature) / 2] : feature_j(c.feature);
    const Vec3 n = (on_b ? 1.0 : -1.0) * (plane.pose->R * plane.shape->faces[face].normal);
    return on_b ? accept(n, distance, c.x_W - distance * n, c.x_W) : accept(n, distance, c.x_W, c.x_W + distance * n);
  }

  static int face_of(const Body& body) {
    for (int i = 0; i < body.pieces.count; ++i)
      if (body.pieces.list[i].kind == Piece::kPlane) return body.pieces.list[i].face;
    return -1;
  }

  // Takes the answer if the bound along its normal is its distance to rounding.
  bool accept(const Vec3& n, double distance, const Vec3& x_a, const Vec3& x_b) {
    const double gap = distance - a_.shape->radius - b_.shape->radius;
    if (!(distance > 0.0) || std::abs(gap - contact_->gap) > kNoise * size_ ||
        distance - along_normal(*a_.shape, *a_.pose, *b_.shape, *b_.pose, n) > kCertified * size_)
      return false;
    contact_->gap = gap;
    contact_->normal = n;
    contact_->point_a = x_a + a_.shape->radius * n;
    contact_->point_b = x_b - b_.shape->radius * n;
    return true;
  }

  Body a_, b_;
  Contact* contact_;
  double size_;  // of the places of points, 1 m at least
};

}  // namespace

double gap_along(const ShapeFeatures& a, const Pose& pose_a, const ShapeFeatures& b, const Pose& pose_b,
                 const Vec3& n_W) {
  if (a.ellipsoid || b.ellipsoid) return -INFINITY;
  const double radii = a.radius + b.radius;
  if (!a.is_unbounded() && !b.is_unbounded()) return along_normal(a, pose_a, b, pose_b, n_W) - radii;
  const ShapeFeatures &plane = a.is_unbounded() ? a : b, &other = a.is_unbounded() ? b : a;
  const Pose &plane_pose = a.is_unbounded() ? pose_a : pose_b, &other_pose = a.is_unbounded() ? pose_b : pose_a;
  const Vec3 n = plane_pose.R * plane.faces[0].normal, x = other_pose.point(support(other, into(other_pose, -n)));
  return n.dot(x - plane_pose.p) - plane.faces[0].offset - radii;
}

bool refine_nearest(const ShapeFeatures& a, const Pose& pose_a, const ShapeFeatures& b, const Pose& pose_b,
                    Contact& contact) {
  if (a.is_unbounded() || b.is_unbounded() || !contact.normal.allFinite()) return false;
  if (a.ellipsoid || b.ellipsoid) return refine_on_ellipsoid(a, pose_a, b, pose_b, contact);
  // The faces of a rough hull are not quite its own: of polytopes coal's distance is the better one.
  const bool polytopes = !is_cylinder(a) && !is_cylinder(b);
  if (polytopes && a.roughness + b.roughness > kFlush) return false;
  return Refinement(a, pose_a, b, pose_b, contact).run();
}

}  // namespace contactvi

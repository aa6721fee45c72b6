#include "geometry/candidates.hpp"

#include <algorithm>
#include <limits>

#include "geometry/line_contact.hpp"

namespace contactvi {

namespace {

// Edges at a smaller angle [rad] have no crossing of their own: vertices near to it bound the contact as well.
constexpr double kEdgeOn = 1e-5;

// One side of a pair: a shape with faces (plane) and the shape over them (other).
struct Over {
  const ShapeFeatures *plane, *other;
  Pose plane_pose, other_pose;
  bool on_b;  // other is b
  Mat3 R;     // other's body frame in plane's
  Vec3 p;
};

Over make_over(const PairView& v, bool on_b) {
  Over o{on_b ? v.a : v.b, on_b ? v.b : v.a, on_b ? v.pose_a : v.pose_b, on_b ? v.pose_b : v.pose_a, on_b, {}, {}};
  o.R.noalias() = o.plane_pose.R.transpose() * o.other_pose.R;
  o.p.noalias() = o.plane_pose.R.transpose() * (o.other_pose.p - o.plane_pose.p);
  return o;
}

// Whether a ball reaches over a face, as far as is known quickly; all in the face's frame.
bool may_be_over(const ShapeFeatures& o, const ShapeFeatures::Face& face, const Vec3& center, double radius) {
  if (face.count == 0) return outside_of(o, face, center) <= radius + kBorder;
  for (int k = face.first; k < face.first + face.count; ++k)
    if (o.side[k].dot(center) - o.side_offset[k] > radius + kBorder) return false;
  return true;
}

// Lists the vertices over a face, with a limit that does not fall in their order. Returns the one that is lowest over
// its plane, if it is wanted.
int vertices_over(const Over& o, int f, bool wants_lowest, std::vector<int>& near, CandidateSink& sink) {
  const ShapeFeatures::Face& face = o.plane->faces[f];
  const Vec3 n = o.R.transpose() * face.normal;  // in the other's frame
  const double base = face.normal.dot(o.p) - face.offset - o.plane->radius - o.other->radius;
  const Feature kind = o.on_b ? Feature::kVertexB : Feature::kVertexA;
  const std::vector<Vec3>& vertices = o.other->vertices;
  const auto look_at = [&](int i, double gap) {
    if (gap > sink.limit) return;
    const Vec3 x = o.R * vertices[i] + o.p;
    if (outside_of(*o.plane, face, x) > kBorder) return;
    sink.add({feature_number(kind, i, f), gap, o.plane_pose.point(x)});
  };
  const VertexTree& tree = o.other->tree;
  if (!tree.none()) {
    const auto reaches = [&](const VertexTree::Bound& bound) {
      return base - bound.reach(-n) <= sink.limit &&
             may_be_over(*o.plane, face, o.R * bound.center + o.p, bound.radius);
    };
    near.clear();
    tree.each(-n, reaches, [&](int i) {
      const double gap = n.dot(vertices[i]) + base;
      if (sink.falls)
        look_at(i, gap);
      else if (gap <= sink.limit)
        near.push_back(i);
    });
    std::sort(near.begin(), near.end());
    for (int i : near) look_at(i, n.dot(vertices[i]) + base);
    return wants_lowest ? tree.farthest(-n) : -1;
  }
  int lowest = -1;
  double least = std::numeric_limits<double>::infinity();
  for (int i = 0; i < static_cast<int>(vertices.size()); ++i) {
    const double gap = n.dot(vertices[i]) + base;
    if (gap < least) {
      least = gap;
      lowest = i;
    }
    look_at(i, gap);
  }
  return lowest;
}

void rim_sides(const Over& o, int r, int f, double gap, CandidateSink& sink) {
  const ShapeFeatures::Face& face = o.plane->faces[f];
  const ShapeFeatures::Rim& rim = o.other->rims[r];
  const Vec3 center = o.R * rim.center + o.p;
  for (int k = face.first; k < face.first + face.count; ++k) {
    const ShapeFeatures::Edge& edge = o.plane->edges[o.plane->ring_edge[k]];
    const Vec3 from = center - edge.start;
    const double along = from.dot(edge.direction);
    const double away = o.plane->side[k].dot(center) - o.plane->side_offset[k];
    const double square = rim.radius * rim.radius - away * away;
    if (square <= 0.0) continue;
    for (int second = 0; second < 2; ++second) {
      const double s = along + (second ? 1.0 : -1.0) * std::sqrt(square);
      if (s < -kBorder || s > edge.length + kBorder) continue;
      const Vec3 x = edge.start + s * edge.direction;
      const Feature kind = o.on_b ? Feature::kRimSideB : Feature::kRimSideA;
      sink.add({feature_number(kind, r, 2 * k + second), gap,
                o.plane_pose.point(x + face.normal * (face.normal.dot(center) - face.offset))});
    }
  }
}

// True if a disc of the centre and radius reaches over the face, all in the face's plane.
bool reaches_over(const ShapeFeatures& o, const ShapeFeatures::Face& face, const Vec3& center, double radius) {
  if (outside_of(o, face, center) <= 0.0) return true;
  if (face.count == 0) return outside_of(o, face, center) <= radius;
  for (int k = face.first; k < face.first + face.count; ++k) {
    const ShapeFeatures::Edge& e = o.edges[o.ring_edge[k]];
    const double s = std::clamp((center - e.start).dot(e.direction), 0.0, e.length);
    const Vec3 d = center - e.start - s * e.direction;
    if ((d - face.normal.dot(d) * face.normal).norm() <= radius) return true;
  }
  return false;
}

// The material point of a rim lowest over a plane of the normal n, in the plane's frame.
Vec3 lowest_rim_point(const Over& o, const ShapeFeatures::Rim& rim, const Vec3& n) {
  Vec3 lowest = o.R * rim_point(rim, 0) + o.p;
  for (int k = 1; k < kRimPoints; ++k) {
    const Vec3 x = o.R * rim_point(rim, k) + o.p;
    if (n.dot(x) < n.dot(lowest)) lowest = x;
  }
  return lowest;
}

void rims_over(const Over& o, int f, bool upcoming, CandidateSink& sink) {
  const ShapeFeatures::Face& face = o.plane->faces[f];
  const double radii = o.plane->radius + o.other->radius;
  for (int r = 0; r < static_cast<int>(o.other->rims.size()); ++r) {
    const ShapeFeatures::Rim& rim = o.other->rims[r];
    const Vec3 axis = o.R * rim.axis, center = o.R * rim.center + o.p;
    const double tilt = rim_tilt(rim.radius, axis, face.normal);
    const double gap = face.normal.dot(center) - tilt - face.offset - radii;
    if (gap > sink.limit) continue;
    if (upcoming || tilt > kUpright) {
      // A flat rim has the lowest of its material points, because these are the points that an impact would find.
      const Vec3 x = tilt > kUpright ? lowest_of_rim(center, axis, rim.radius, face.normal)
                                     : lowest_rim_point(o, rim, face.normal);
      // A flat rim is over the face where any of its points is.
      const bool over =
          tilt > kUpright ? outside_of(*o.plane, face, x) <= kBorder : reaches_over(*o.plane, face, center, rim.radius);
      if (!over) continue;
      const double at_x = tilt > kUpright ? gap : face.normal.dot(x) - face.offset - radii;
      sink.add({feature_number(o.on_b ? Feature::kRimB : Feature::kRimA, r, f), at_x, o.plane_pose.point(x)});
      continue;
    }
    for (int k = 0; k < kRimPoints; ++k) {
      const Vec3 x = o.R * rim_point(rim, k) + o.p;
      if (outside_of(*o.plane, face, x) > kBorder) continue;
      const double g = face.normal.dot(x) - face.offset - radii;
      if (g > sink.limit) continue;
      sink.add({feature_number(o.on_b ? Feature::kRimPointB : Feature::kRimPointA, r * kRimPoints + k, f), g,
                o.plane_pose.point(x)});
    }
    rim_sides(o, r, f, gap, sink);
  }
}

// Sides of the plate of a face, edges at the vertex nearest to the other body, and axes.
void edges_near(const ShapeFeatures& o, int face, int vertex, std::vector<int>& list) {
  list.clear();
  if (face >= 0) {
    for (int f : o.plates[o.faces[face].plate]) {
      for (int k = o.faces[f].first; k < o.faces[f].first + o.faces[f].count; ++k) {
        const ShapeFeatures::Edge& e = o.edges[o.ring_edge[k]];
        const bool inner = e.left >= 0 && e.right >= 0 && o.faces[e.left].plate == o.faces[e.right].plate;
        if (!inner) list.push_back(o.ring_edge[k]);
      }
    }
  }
  const std::size_t ring = list.size();
  if (vertex >= 0)
    for (int e : o.vertex_edges[vertex])
      if (std::find(list.begin(), list.begin() + ring, e) == list.begin() + ring) list.push_back(e);
  if (o.edges.size() == 1 && list.empty()) list.push_back(0);
}

// Where a line is: its middle, half its length, and the heights along n of both.
Reach reach_of(const Line& line, const Vec3& n) {
  const double half = 0.5 * line.length;
  const Vec3 middle = line.start + half * line.direction;
  return {middle, half, n.dot(middle), half * std::abs(n.dot(line.direction))};
}

// Whether two edges are farther from each other than `far`, and higher over each other along n, wherever they cross in
// the view along it.
bool are_apart(const Reach& a, const Reach& b, double far) {
  if (!(b.height - a.height - a.rise - b.rise > far)) return false;
  const double reach = far + a.half + b.half;
  return (b.middle - a.middle).squaredNorm() > reach * reach;
}

void edges_across(const PairView& v, const Sides& sides, bool upcoming, NearFeatures& near, CandidateSink& sink) {
  near.lines_b.clear();
  near.reaches_b.clear();
  for (int j : near.b) {
    near.lines_b.push_back(line_of(*v.b, v.pose_b, j));
    near.reaches_b.push_back(reach_of(near.lines_b.back(), sides.n_W));
  }
  // Of two capsules the nearest points are known without their crossing.
  const bool cross = !v.a->faces.empty() || !v.b->faces.empty();
  Crossing c;
  for (int i : near.a) {
    const Line a = line_of(*v.a, v.pose_a, i);
    const Reach reach_a = reach_of(a, sides.n_W);
    for (std::size_t k = 0; k < near.b.size(); ++k) {
      const Line& b = near.lines_b[k];
      const int j = near.b[k];
      if (are_apart(reach_a, near.reaches_b[k], std::max(0.0, sink.limit) + a.radius + b.radius + kBorder)) continue;
      list_line_ends(v, i, a, j, b, upcoming, sink);
      if (!cross || are_flat(a, b) || !cross_lines(a, b, sides.n_W, kBorder, c)) continue;
      const bool over = c.beyond <= kBorder;
      if (!upcoming && !over) continue;
      // Beyond the flat ends of a lying cylinder the height of its axis has no meaning.
      const bool polygons = v.a->edges[i].radius == 0.0 && v.b->edges[j].radius == 0.0;
      if (!over && !(polygons && c.beyond_in_view <= 0.0)) continue;
      const double gap = over ? c.gap : c.height;
      if (gap > sink.limit || (!upcoming && outside_cone(v, i, j, c.normal) > kNormalCone)) continue;
      sink.add({feature_number(Feature::kEdges, i, j), gap, 0.5 * (c.point_a + c.point_b)});
    }
  }
}

}  // namespace

Vec3 lowest_of_rim(const Vec3& center, const Vec3& axis, double radius, const Vec3& n) {
  Vec3 down = n.dot(axis) * axis - n;
  const double length = down.norm();
  if (length > 0.0) return center + (radius / length) * down;
  Eigen::Index smallest;
  axis.cwiseAbs().minCoeff(&smallest);
  return center + radius * axis.cross(Vec3::Unit(smallest)).normalized();
}

Vec3 rim_point(const ShapeFeatures::Rim& rim, int k) {
  // Tabulated, so that the points are exact at the quarters and equal on all machines.
  static const double kSin[4] = {0.0, 0.5, 0.86602540378443864676, 1.0};
  const int quarter = k / 3, step = k % 3;
  const double c = kSin[3 - step], s = kSin[step];
  const double x[4] = {c, -s, -c, s}, y[4] = {s, c, -s, -c};
  return rim.center + rim.radius * (x[quarter] * rim.zero + y[quarter] * rim.quarter);
}

bool cross_lines(const Line& a, const Line& b, const Vec3& n, double border, Crossing& c) {
  const Vec3 cross = a.direction.cross(b.direction);
  const double in_view = n.dot(cross);
  if (std::abs(in_view) < kEdgeOn) return false;
  const Vec3 d = b.start - a.start, d_b = d.cross(b.direction), d_a = d.cross(a.direction);
  auto beyond = [&](double s, double t) { return std::max({-s, s - a.length, -t, t - b.length}); };
  c.beyond_in_view = beyond(n.dot(d_b) / in_view, n.dot(d_a) / in_view);
  const double square = cross.squaredNorm(), s = d_b.dot(cross) / square, t = d_a.dot(cross) / square;
  c.beyond = beyond(s, t);
  if (c.beyond > border && c.beyond_in_view > border) return false;
  c.height = d.dot(cross) / in_view - a.radius - b.radius;
  c.normal = (in_view > 0.0 ? 1.0 : -1.0) / std::sqrt(square) * cross;
  c.point_a = a.start + s * a.direction;
  c.point_b = b.start + t * b.direction;
  c.gap = d.dot(c.normal) - a.radius - b.radius;
  return true;
}

void list_candidates(const PairView& v, const Sides& sides, bool upcoming, NearFeatures& near, CandidateSink& sink) {
  const bool crosses = !v.a->edges.empty() && !v.b->edges.empty();
  int lowest[2] = {-1, -1};  // of a over b's face, of b over a's
  for (bool on_b : {true, false}) {
    const int face = on_b ? sides.a : sides.b;
    if (face < 0) continue;
    const Over o = make_over(v, on_b);
    for (int f : o.plane->plates[o.plane->faces[face].plate]) {
      const int i = vertices_over(o, f, crosses && f == face, near.vertices, sink);
      if (f == face) lowest[on_b] = i;
      rims_over(o, f, upcoming, sink);
    }
  }
  if (!crosses) return;
  edges_near(*v.a, sides.a, lowest[0], near.a);
  edges_near(*v.b, sides.b, lowest[1], near.b);
  edges_across(v, sides, upcoming, near, sink);
}

}  // namespace contactvi

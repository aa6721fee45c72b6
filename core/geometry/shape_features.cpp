#include "geometry/shape_features.hpp"

#include <coal/shape/convex.h>
#include <coal/shape/geometric_shapes.h>

#include <algorithm>
#include <limits>
#include <numeric>

#include "base/disjoint_sets.hpp"
#include "base/parallel.hpp"
#include "base/refusal.hpp"
#include "geometry/planar_hull.hpp"

namespace contactvi {

namespace {

// Points closer to a plane than this part of the hull's size lie on it: meshes come in single precision, and the
// vertices of rounded hulls are intersections of such planes.
constexpr double kFlat = 4e-7;
// Points closer to each other than this part of the hull's size are one.
constexpr double kSame = 1e-9;
// Neighbouring faces at a smaller angle [rad] belong to one flat side.
constexpr double kPlateAngle = 1e-4;

using Points = std::vector<Vec3>;

struct Polygon {
  Vec3 normal;
  double offset;
  std::vector<int> corners;
};

// Corners in order of the convex hull of points that lie in one plane, without those on its sides.
std::vector<int> order_corners(const Points& points, std::vector<int> all, const Vec3& normal, double flat) {
  Eigen::Index smallest;
  normal.cwiseAbs().minCoeff(&smallest);
  const Vec3 u = normal.cross(Vec3::Unit(smallest)).normalized(), v = normal.cross(u);
  auto at = [&](int i) { return Eigen::Vector2d(points[i].dot(u), points[i].dot(v)); };
  // A corner lies farther than `flat` to the right of the line between its neighbours.
  auto turns = [&](int i, int j, int k) {
    const Eigen::Vector2d a = at(i), b = at(j), c = at(k);
    const double ex = c[0] - a[0], ey = c[1] - a[1], length = std::hypot(ex, ey);
    const double left = length == 0.0 ? 0.0 : (ex * (b[1] - a[1]) - ey * (b[0] - a[0])) / length;
    return left < -flat;
  };
  std::vector<int> hull;
  planar_hull(all, at, turns, hull);
  return hull;
}

// Whether one number is in all three ascending lists.
bool share_a_face(const std::vector<int>& a, const std::vector<int>& b, const std::vector<int>& c) {
  for (int f : a)
    if (std::binary_search(b.begin(), b.end(), f) && std::binary_search(c.begin(), c.end(), f)) return true;
  return false;
}

// Which points of a hull its triangles join, points at the same place being one. Finds the points in a plane that
// touches the hull by walking from one to the next: those above any plane are joined with each other.
class HullWalk {
 public:
  HullWalk(const Points& points, const std::vector<coal::Triangle>& triangles, const std::vector<int>& same)
      : points_(points), neighbors_(points.size()), walk_of_(points.size(), 0) {
    for (const coal::Triangle& t : triangles)
      for (int k = 0; k < 3; ++k) {
        const int i = same[t[k]], j = same[t[(k + 1) % 3]];
        if (i == j) continue;
        neighbors_[i].push_back(j);
        neighbors_[j].push_back(i);
      }
  }

  // The points within `flat` of the plane, ascending; the three numbers are some of them.
  void find(const Vec3& normal, double offset, double flat, std::initializer_list<int> start, std::vector<int>& found) {
    found.clear();
    ++walk_;
    open_.clear();
    for (int i : start) enter(i);
    while (!open_.empty()) {
      const int i = open_.back();
      open_.pop_back();
      const double above = normal.dot(points_[i]) - offset;
      if (above < -flat) continue;
      if (!(above > flat)) found.push_back(i);
      for (int j : neighbors_[i]) enter(j);
    }
    std::sort(found.begin(), found.end());
  }

 private:
  void enter(int i) {
    if (walk_of_[i] == walk_) return;
    walk_of_[i] = walk_;
    open_.push_back(i);
  }

  const Points& points_;
  std::vector<std::vector<int>> neighbors_;
  std::vector<int> walk_of_;  // the last walk that came to the point
  std::vector<int> open_;
  int walk_ = 0;
};

// The faces of a hull from its triangles, largest first; a face has all points in its plane.
std::vector<Polygon> merge_triangles(const Points& points, const std::vector<coal::Triangle>& triangles, double size,
                                     const std::vector<int>& same, double& roughness) {
  struct Seed {
    double area;
    int i;
    Vec3 normal;
  };
  std::vector<Seed> seeds;
  for (std::size_t i = 0; i < triangles.size(); ++i) {
    const coal::Triangle& t = triangles[i];
    const Vec3 c = (points[t[1]] - points[t[0]]).cross(points[t[2]] - points[t[0]]);
    if (c.norm() > kSame * kSame * size * size) seeds.push_back({c.norm(), static_cast<int>(i), c.normalized()});
  }
  std::stable_sort(seeds.begin(), seeds.end(), [](const Seed& s, const Seed& t) { return s.area > t.area; });
  Vec3 center = Vec3::Zero();
  for (const Vec3& p : points) center += p / static_cast<double>(points.size());
  HullWalk walk(points, triangles, same);
  std::vector<Polygon> faces;
  std::vector<std::vector<int>> faces_of(points.size());  // per point: the faces found so far that have it, ascending
  std::vector<int> all;
  const double flat = kFlat * size;
  for (const Seed& seed : seeds) {
    const coal::Triangle& t = triangles[seed.i];
    const int a = same[t[0]], b = same[t[1]], c = same[t[2]];
    if (share_a_face(faces_of[a], faces_of[b], faces_of[c])) continue;
    Polygon face;
    face.normal = seed.normal.dot(points[a] - center) < 0.0 ? Vec3(-seed.normal) : seed.normal;
    face.offset = face.normal.dot(points[a]);
    walk.find(face.normal, face.offset, flat, {a, b, c}, all);
    face.corners = order_corners(points, all, face.normal, flat);
    if (face.corners.size() < 3) continue;
    // The plane of the whole polygon (Newell) has less rounding than that of one triangle.
    Vec3 n = Vec3::Zero();
    for (std::size_t k = 0; k < face.corners.size(); ++k)
      n += (points[face.corners[k]] - points[face.corners[0]])
               .cross(points[face.corners[(k + 1) % face.corners.size()]] - points[face.corners[0]]);
    face.normal = n.normalized();
    face.offset = -std::numeric_limits<double>::infinity();
    for (int i : face.corners) face.offset = std::max(face.offset, face.normal.dot(points[i]));
    for (int i : face.corners) roughness = std::max(roughness, face.offset - face.normal.dot(points[i]));
    for (int i : all) faces_of[i].push_back(static_cast<int>(faces.size()));
    faces.push_back(std::move(face));
  }
  return faces;
}

Vec3 to_body(const Geometry& g, const Vec3& x) { return g.R_BG * x + g.p_BG; }

void join_plates(ShapeFeatures& o) {
  DisjointSets sets(static_cast<int>(o.faces.size()));
  for (const ShapeFeatures::Edge& e : o.edges) {
    if (e.left < 0 || e.right < 0) continue;
    if (o.faces[e.left].normal.cross(o.faces[e.right].normal).norm() > kPlateAngle) continue;
    sets.join(e.left, e.right);
  }
  std::vector<int> number(o.faces.size(), -1);
  for (std::size_t i = 0; i < o.faces.size(); ++i) {
    int& plate = number[sets.root(static_cast<int>(i))];
    if (plate < 0) {
      plate = static_cast<int>(o.plates.size());
      o.plates.emplace_back();
    }
    o.faces[i].plate = plate;
    o.plates[plate].push_back(static_cast<int>(i));
  }
}

// The edge between two vertices, -1 if there is none yet.
int edge_between(const ShapeFeatures& o, int i, int j) {
  for (int e : o.vertex_edges[i])
    if (o.edges[e].v0 == j || o.edges[e].v1 == j) return e;
  return -1;
}

// Faces, sides and edges of a polytope whose corners index points of the body frame.
void add_polygons(ShapeFeatures& o, const Points& points, const std::vector<Polygon>& polygons) {
  std::vector<int> number(points.size(), -1);
  for (const Polygon& p : polygons)
    for (int i : p.corners) number[i] = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (number[i] < 0) continue;
    number[i] = static_cast<int>(o.vertices.size());
    o.vertices.push_back(points[i]);
  }
  o.vertex_edges.resize(o.vertices.size());
  o.vertex_faces.resize(o.vertices.size());
  for (const Polygon& p : polygons) {
    const int f = static_cast<int>(o.faces.size()), n = static_cast<int>(p.corners.size());
    o.faces.push_back({p.normal, p.offset, static_cast<int>(o.ring.size()), n, Vec3::Zero(), 0.0, 0});
    for (int k = 0; k < n; ++k) {
      const int i = number[p.corners[k]], j = number[p.corners[(k + 1) % n]];
      const Vec3 along = o.vertices[j] - o.vertices[i];
      o.ring.push_back(i);
      o.ring_face.push_back(f);
      o.side.push_back(along.cross(p.normal).normalized());
      o.side_offset.push_back(o.side.back().dot(o.vertices[i]));
      o.vertex_faces[i].push_back(f);
      const int known = edge_between(o, i, j), edge = known < 0 ? static_cast<int>(o.edges.size()) : known;
      o.ring_edge.push_back(edge);
      if (known < 0) {
        // The corners of f are in anticlockwise order, so f is at the left of the edge.
        o.edges.push_back({i, j, o.vertices[i], along.normalized(), along.norm(), f, -1, 0.0});
        o.vertex_edges[i].push_back(edge);
        o.vertex_edges[j].push_back(edge);
      } else {
        o.edges[edge].right = f;
      }
    }
  }
  for (ShapeFeatures::Edge& e : o.edges) {
    if (e.right < 0) continue;
    if (o.faces[e.left].normal.cross(o.faces[e.right].normal).dot(e.direction) < 0.0) std::swap(e.left, e.right);
  }
}

void add_box(ShapeFeatures& o, const Geometry& g, const Vec3& half) {
  Points points;
  for (int i = 0; i < 8; ++i)
    points.push_back(to_body(g, {i & 1 ? half[0] : -half[0], i & 2 ? half[1] : -half[1], i & 4 ? half[2] : -half[2]}));
  std::vector<Polygon> faces;
  for (int axis = 0; axis < 3; ++axis)
    for (int sign : {-1, 1}) {
      const int u = 1 << (axis + 1) % 3, v = 1 << (axis + 2) % 3, base = sign > 0 ? 1 << axis : 0;
      const Vec3 normal = sign * g.R_BG.col(axis);
      std::vector<int> corners{base, base | u, base | u | v, base | v};
      if (sign < 0) std::reverse(corners.begin(), corners.end());
      faces.push_back({normal, half[axis] + normal.dot(g.p_BG), std::move(corners)});
    }
  add_polygons(o, points, faces);
}

// Per point the first one that is within `near` of it; the first of that one if it has one.
std::vector<int> first_at_same_place(const Points& points, double near) {
  const int n = static_cast<int>(points.size());
  std::vector<int> same(n), order(n), place(n);
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(),
            [&](int i, int j) { return points[i][0] != points[j][0] ? points[i][0] < points[j][0] : i < j; });
  for (int k = 0; k < n; ++k) place[order[k]] = k;
  for (int i = 0; i < n; ++i) {
    int first = i;
    auto compare = [&](int k) {  // false: this point and those beyond it are too far along x
      const int j = order[k];
      if (std::abs(points[j][0] - points[i][0]) > near) return false;
      if (j < first && (points[i] - points[j]).squaredNorm() <= near * near) first = j;
      return true;
    };
    for (int k = place[i] - 1; k >= 0 && compare(k);) --k;
    for (int k = place[i] + 1; k < n && compare(k);) ++k;
    same[i] = first == i ? i : same[first];
  }
  return same;
}

// Each triangle as a face.
std::vector<Polygon> single_triangles(const Points& points, const std::vector<coal::Triangle>& triangles, double size,
                                      const std::vector<int>& same) {
  Vec3 center = Vec3::Zero();
  for (const Vec3& p : points) center += p / static_cast<double>(points.size());
  std::vector<Polygon> faces;
  for (const coal::Triangle& t : triangles) {
    const int a = same[t[0]], b = same[t[1]], c = same[t[2]];
    const Vec3 normal = (points[b] - points[a]).cross(points[c] - points[a]);
    if (!(normal.norm() > kSame * kSame * size * size)) continue;
    if (normal.dot(points[a] - center) >= 0.0) {
      faces.push_back({normal.normalized(), normal.normalized().dot(points[a]), {a, b, c}});
    } else {
      faces.push_back({-normal.normalized(), -normal.normalized().dot(points[a]), {a, c, b}});
    }
  }
  return faces;
}

void add_hull(ShapeFeatures& o, const Geometry& g, const coal::ConvexBase& shape, bool meets_ellipsoid) {
  const auto* hull = dynamic_cast<const coal::Convex<coal::Triangle>*>(&shape);
  if (hull == nullptr || !hull->polygons) throw Error("a convex shape has no triangles");
  Points points;
  for (unsigned i = 0; i < hull->num_points; ++i) points.push_back(to_body(g, (*hull->points)[i]));
  Vec3 low = points[0], high = points[0];
  for (const Vec3& p : points) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  const double size = (high - low).norm();
  const std::vector<int> same = first_at_same_place(points, kSame * size);
  add_polygons(o, points, merge_triangles(points, *hull->polygons, size, same, o.roughness));
  if (!meets_ellipsoid) return;
  auto triangles = std::make_shared<ShapeFeatures>();
  triangles->radius = o.radius;
  add_polygons(*triangles, points, single_triangles(points, *hull->polygons, size, same));
  o.triangles = std::move(triangles);
}

void add_axis(ShapeFeatures& o, const Geometry& g, double half, double radius) {
  const Vec3 z = g.R_BG.col(2);
  o.edges.push_back({-1, -1, g.p_BG - half * z, z, 2.0 * half, -1, -1, radius});
}

void add_cylinder(ShapeFeatures& o, const Geometry& g, const coal::Cylinder& shape) {
  add_axis(o, g, shape.halfLength, shape.radius);
  for (int sign : {-1, 1}) {
    const Vec3 normal = sign * g.R_BG.col(2), center = g.p_BG + shape.halfLength * normal;
    o.faces.push_back({normal, normal.dot(center), 0, 0, center, shape.radius, 0});
    o.rims.push_back({center, normal, g.R_BG.col(0), g.R_BG.col(1), shape.radius});
  }
}

ShapeFeatures make_shape_features(const Geometry& g, const coal::CollisionGeometry& shape, bool meets_ellipsoid) {
  ShapeFeatures o;
  o.body = g.body;
  o.radius = static_cast<const coal::ShapeBase&>(shape).getSweptSphereRadius();
  switch (shape.getNodeType()) {
    case coal::GEOM_SPHERE:
      o.vertices.push_back(g.p_BG);
      o.radius += static_cast<const coal::Sphere&>(shape).radius;
      break;
    case coal::GEOM_CAPSULE: {
      const auto& capsule = static_cast<const coal::Capsule&>(shape);
      o.radius += capsule.radius;
      add_axis(o, g, capsule.halfLength, 0.0);
      o.vertices = {to_body(g, {0, 0, -capsule.halfLength}), to_body(g, {0, 0, capsule.halfLength})};
      o.edges[0].v0 = 0;
      o.edges[0].v1 = 1;
      break;
    }
    case coal::GEOM_BOX:
      add_box(o, g, static_cast<const coal::Box&>(shape).halfSide);
      break;
    case coal::GEOM_CYLINDER:
      add_cylinder(o, g, static_cast<const coal::Cylinder&>(shape));
      break;
    case coal::GEOM_CONVEX:
      add_hull(o, g, static_cast<const coal::ConvexBase&>(shape), meets_ellipsoid);
      break;
    case coal::GEOM_HALFSPACE: {
      const Vec3 normal = g.R_BG * g.halfspace_normal;
      const double infinite = std::numeric_limits<double>::infinity();
      o.faces.push_back({normal, g.halfspace_offset + normal.dot(g.p_BG), 0, 0, Vec3::Zero(), infinite, 0});
      break;
    }
    case coal::GEOM_ELLIPSOID:
      o.ellipsoid = Ellipsoid{g.p_BG, g.R_BG, static_cast<const coal::Ellipsoid&>(shape).radii};
      break;
    default:
      break;
  }
  o.vertex_edges.resize(o.vertices.size());
  o.vertex_faces.resize(o.vertices.size());
  if (o.vertices.size() == 2) o.vertex_edges = {{0}, {0}};
  join_plates(o);
  // This is the largest number that a feature number (candidates.hpp) can hold.
  if (std::max(o.ring.size(), o.edges.size()) > (1u << 19))
    throw Refusal("A convex shape has too many edges", "at most 524288",
                  std::to_string(std::max(o.ring.size(), o.edges.size())),
                  "Simplify the mesh, or replace it by a box, a ball or a capsule");
  return o;
}

}  // namespace

void add_shape_features(Scene& scene) {
  std::vector<bool> meets_ellipsoid(scene.geometries.size(), false);
  for (const Pair& pair : scene.pairs)
    for (const auto& [one, other] : {std::pair(pair.a, pair.b), std::pair(pair.b, pair.a)})
      if (scene.geometries[one].sharp->getNodeType() == coal::GEOM_ELLIPSOID) meets_ellipsoid[other] = true;
  // In the order in which the pairs need them; a shape may be needed sharp and rounded.
  std::vector<std::pair<int, bool>> needed;
  std::vector<bool> taken(2 * scene.geometries.size(), false);
  for (const Pair& pair : scene.pairs)
    for (int i : {pair.a, pair.b}) {
      const Geometry& g = scene.geometries[i];
      const bool rounded = pair.rounded && g.rounded;
      if (taken[2 * i + rounded] || (rounded ? g.rounded_features : g.sharp_features)) continue;
      taken[2 * i + rounded] = true;
      needed.emplace_back(i, rounded);
    }
  in_parallel(static_cast<int>(needed.size()), [&](int k) {
    const auto [i, rounded] = needed[k];
    Geometry& g = scene.geometries[i];
    (rounded ? g.rounded_features : g.sharp_features) = std::make_shared<const ShapeFeatures>(
        make_shape_features(g, rounded ? *g.rounded : *g.sharp, meets_ellipsoid[i]));
  });
}

double outside_of(const ShapeFeatures& o, const ShapeFeatures::Face& face, const Vec3& x) {
  if (face.count == 0) {
    if (std::isinf(face.radius)) return 0.0;
    const Vec3 d = x - face.center;
    return (d - face.normal.dot(d) * face.normal).norm() - face.radius;
  }
  double worst = -std::numeric_limits<double>::infinity();
  for (int i = face.first; i < face.first + face.count; ++i)
    worst = std::max(worst, o.side[i].dot(x) - o.side_offset[i]);
  return worst;
}

}  // namespace contactvi

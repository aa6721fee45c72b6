#include "geometry/shape_features.hpp"

#include <coal/shape/convex.h>
#include <coal/shape/geometric_shapes.h>

#include <algorithm>
#include <limits>

#include "base/disjoint_sets.hpp"
#include "base/refusal.hpp"
#include "geometry/hull_faces.hpp"

namespace contactvi {

namespace {

// Neighbouring faces at a smaller angle [rad] belong to one flat side.
constexpr double kPlateAngle = 1e-4;

// The largest number of edges and of corners of faces that a feature number (contact_features.hpp) can hold.
constexpr std::size_t kMostEdges = 1u << 19;

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
void add_polygons(ShapeFeatures& o, const Points& points, const Polygons& polygons) {
  std::vector<int> number(points.size(), -1), faces_at(points.size(), 0);
  for (int i : polygons.corners()) ++faces_at[i];
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (faces_at[i] == 0) continue;
    number[i] = static_cast<int>(o.vertices.size());
    o.vertices.push_back(points[i]);
  }
  o.vertex_edges.resize(o.vertices.size());
  o.vertex_faces.resize(o.vertices.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (faces_at[i] == 0) continue;
    o.vertex_edges[number[i]].reserve(faces_at[i]);  // In a closed surface as many edges as faces meet at a vertex.
    o.vertex_faces[number[i]].reserve(faces_at[i]);
  }
  const std::size_t sides = polygons.corners().size();
  o.faces.reserve(polygons.faces().size());
  o.edges.reserve(sides / 2);
  for (std::vector<int>* numbers : {&o.ring, &o.ring_face, &o.ring_edge}) numbers->reserve(sides);
  o.side.reserve(sides);
  o.side_offset.reserve(sides);
  for (const Polygons::Face& p : polygons.faces()) {
    const int f = static_cast<int>(o.faces.size()), n = p.count;
    o.faces.push_back({p.normal, p.offset, static_cast<int>(o.ring.size()), n, Vec3::Zero(), 0.0, 0});
    for (int k = 0; k < n; ++k) {
      const int i = number[polygons.corner(p, k)], j = number[polygons.corner(p, (k + 1) % n)];
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
  Polygons faces;
  for (int axis = 0; axis < 3; ++axis)
    for (int sign : {-1, 1}) {
      const int u = 1 << (axis + 1) % 3, v = 1 << (axis + 2) % 3, base = sign > 0 ? 1 << axis : 0;
      const Vec3 normal = sign * g.R_BG.col(axis);
      const double offset = half[axis] + normal.dot(g.p_BG);
      if (sign > 0)
        faces.push(normal, offset, {base, base | u, base | u | v, base | v});
      else
        faces.push(normal, offset, {base | v, base | u | v, base | u, base});
    }
  add_polygons(o, points, faces);
}

using Hull = coal::Convex<coal::Triangle>;

const Hull& hull_of(const coal::CollisionGeometry& shape) {
  const auto* hull = dynamic_cast<const Hull*>(&shape);
  if (hull == nullptr || !hull->polygons) throw Error("a convex shape has no triangles");
  return *hull;
}

void add_hull(ShapeFeatures& o, const Geometry& g, const Hull& hull, bool meets_ellipsoid) {
  Points points;
  points.reserve(hull.num_points);
  for (unsigned i = 0; i < hull.num_points; ++i) points.push_back(to_body(g, (*hull.points)[i]));
  const HullFaces faces(points, *hull.polygons);
  add_polygons(o, points, faces.merged(o.roughness));
  o.tree = VertexTree(o.vertices);
  if (!meets_ellipsoid) return;
  auto triangles = std::make_shared<ShapeFeatures>();
  triangles->radius = o.radius;
  add_polygons(*triangles, points, faces.single());
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
      add_hull(o, g, hull_of(shape), meets_ellipsoid);
      break;
    case coal::GEOM_HALFSPACE: {
      const Vec3 normal = g.R_BG * g.halfspace_normal;
      const double infinite = std::numeric_limits<double>::infinity();
      o.faces.push_back({normal, g.halfspace_offset + normal.dot(g.p_BG), 0, 0, Vec3::Zero(), infinite, 0});
      break;
    }
    case coal::GEOM_ELLIPSOID:
      o.ellipsoid = Ellipsoid{g.p_BG, g.R_BG, static_cast<const coal::Ellipsoid&>(*g.sharp).radii, o.radius};
      break;
    default:
      break;
  }
  o.vertex_edges.resize(o.vertices.size());
  o.vertex_faces.resize(o.vertices.size());
  if (o.vertices.size() == 2) o.vertex_edges = {{0}, {0}};
  join_plates(o);
  if (std::max(o.ring.size(), o.edges.size()) > kMostEdges)
    throw Refusal("A convex shape has too many edges", "at most " + std::to_string(kMostEdges),
                  std::to_string(std::max(o.ring.size(), o.edges.size())),
                  "Simplify the mesh, or replace it by a box, a ball or a capsule");
  return o;
}

// Whether a hull has so many triangles that its edges may be too many. Throws Error for one without triangles.
bool may_be_refused(const coal::CollisionGeometry& shape) {
  return shape.getNodeType() == coal::GEOM_CONVEX && 3 * std::size_t{hull_of(shape).num_polygons} > kMostEdges;
}

}  // namespace

void add_shape_features(Scene& scene) {
  std::vector<bool> meets_ellipsoid(scene.geometries.size(), false);
  for (const Pair& pair : scene.pairs)
    for (const auto& [one, other] : {std::pair(pair.a, pair.b), std::pair(pair.b, pair.a)})
      if (scene.geometries[one].sharp->getNodeType() == coal::GEOM_ELLIPSOID) meets_ellipsoid[other] = true;
  for (const Pair& pair : scene.pairs)
    for (int i : {pair.a, pair.b}) {
      Geometry& g = scene.geometries[i];
      const bool rounded = pair.rounded && g.rounded;
      auto& features = rounded ? g.rounded_features : g.sharp_features;
      if (features) continue;
      features =
          std::make_shared<const OnDemand<ShapeFeatures>>([g, rounded, meets = static_cast<bool>(meets_ellipsoid[i])] {
            return make_shape_features(g, rounded ? *g.rounded : *g.sharp, meets);
          });
      if (may_be_refused(rounded ? *g.rounded : *g.sharp)) features->get();
    }
}

int farthest_vertex(const ShapeFeatures& o, const Vec3& m) {
  if (!o.tree.none()) return o.tree.farthest(m);
  int best = -1;
  double most = -std::numeric_limits<double>::infinity();
  for (int i = 0; i < static_cast<int>(o.vertices.size()); ++i) {
    const double along = m.dot(o.vertices[i]);
    if (along <= most) continue;
    most = along;
    best = i;
  }
  return best;
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

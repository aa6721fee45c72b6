// The features by which a collision shape touches: vertices, edges, faces and rims of a core that is swept by a sphere.
//
//   shape      vertices  edges     faces         rims  swept by its
//   sphere     1         -         -             -     radius
//   capsule    2         its axis  -             -     radius
//   box        8         12        6             -     -
//   convex     N         all       all           -     -
//   cylinder   -         its axis  2 discs       2     - (the axis by the cylinder's radius)
//   halfspace  -         -         1, unbounded  -     -
//   ellipsoid  -         -         -             -     - (the ellipsoid itself)
//
// and all of them by coal's own swept sphere. Coplanar triangles of a hull are one face, also where they are so only in
// single precision; points inside of a face or an edge are dropped. An ellipsoid meets the triangles as they are.
#pragma once

#include <cmath>
#include <memory>
#include <optional>
#include <vector>

#include "geometry/ellipsoid.hpp"
#include "geometry/vertex_tree.hpp"
#include "model/scene.hpp"

namespace contactvi {

struct ShapeFeatures {
  struct Face {
    Vec3 normal;       // outward; the core lies at normal.x <= offset
    double offset;     // [m]
    int first, count;  // corners: ring[first ..], anticlockwise seen from outside; none: a disc, or unbounded
    Vec3 center;       // of a disc
    double radius;     // of a disc; infinite for a halfspace, 0 for a polygon
    int plate;
  };
  struct Edge {
    int v0, v1;
    Vec3 start, direction;  // direction: unit
    double length;
    int left, right;  // faces, normal(left) x normal(right) points along the edge; -1: none
    double radius;    // swept by this besides ShapeFeatures::radius
  };
  struct Rim {
    Vec3 center, axis;   // axis: unit, outward of the shape
    Vec3 zero, quarter;  // unit vectors across the axis, where its material points are counted from
    double radius;
  };

  // All vectors are in the frame of the geometry's body.
  double radius = 0;     // the core is swept by this
  double roughness = 0;  // how far corners of a face may lie below its plane [m]
  std::vector<Vec3> vertices;
  std::vector<Edge> edges;
  std::vector<Face> faces;
  std::vector<Rim> rims;
  std::optional<Ellipsoid> ellipsoid;
  // Of a hull in a pair with an ellipsoid, its own triangles as faces, which miss one plane by up to the roughness.
  std::shared_ptr<const ShapeFeatures> triangles;
  std::vector<int> ring;       // vertices of the polygons
  std::vector<int> ring_edge;  // the edge from ring[i] to the next corner
  std::vector<int> ring_face;
  std::vector<Vec3> side;  // outward normal of the polygon's side there, in its plane
  std::vector<double> side_offset;
  std::vector<std::vector<int>> vertex_edges, vertex_faces;
  VertexTree tree;                       // of a hull with many vertices
  std::vector<std::vector<int>> plates;  // faces that meet at less than 1e-4 rad: together one flat side

  bool is_unbounded() const { return !faces.empty() && std::isinf(faces[0].radius); }
};

// Gives the geometries the features that the scene's pairs need, where they have none. Throws Error for a hull without
// triangles and Refusal for one with too many edges, now and not when the features are made.
void add_shape_features(Scene& scene);

// Of the shape that distances of a pair refer to: rounded or sharp.
inline const ShapeFeatures& shape_features_of(const Geometry& geometry, bool rounded) {
  return (rounded && geometry.rounded ? geometry.rounded_features : geometry.sharp_features)->get();
}

// Those that an ellipsoid meets. It rolls from one triangle to the next, and its gap may not jump there.
inline const ShapeFeatures& features_for_ellipsoid(const ShapeFeatures& shape) {
  return shape.triangles ? *shape.triangles : shape;
}

// The vertex that lies farthest along the unit vector m, the first of several; of a shape that has vertices.
int farthest_vertex(const ShapeFeatures& shape_features, const Vec3& m);
// How far x lies outside of the prism over a face [m], negative inside; 0 over a halfspace.
double outside_of(const ShapeFeatures& shape_features, const ShapeFeatures::Face& face, const Vec3& x);

}  // namespace contactvi

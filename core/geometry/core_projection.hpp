// The point of a core that is nearest to a given point outside of it, and how it moves with that point.
//
// The cores are those of shape_features.hpp without ellipsoids: a point, a segment, a polytope, a cylinder. The nearest
// point of a convex body is unique and moves continuously. Where it changes from one feature to the next (a face to its
// edge) its derivative jumps, and either one is good.
#pragma once

#include "geometry/shape_features.hpp"

namespace contactvi {

class CoreProjection {
 public:
  // outward: a direction from the core towards the points that will be asked for, in the shape's frame. Of a polytope
  // it says where to look first.
  CoreProjection(const ShapeFeatures& shape, const Vec3& outward);

  // The nearest point y to x in the shape's frame, and dy/dx, which is symmetric with eigenvalues from 0 to 1. False
  // where x is not outside of the core.
  bool project(const Vec3& x, Vec3& y, Mat3& change);
  // Whether y is the nearest point to x: of a polytope that no vertex lies beyond y in the direction of x. Where
  // triangles without an area are missing, project may have come to a stop at their border.
  bool is_nearest(const Vec3& x, const Vec3& y) const;
  // Where the last nearest point lies on a polytope: on a vertex, else on an edge, else inside of a face.
  struct Place {
    int face = -1, edge = -1, vertex = -1;
  };
  const Place& place() const { return place_; }

 private:
  // The point of one face that is nearest to x: inside, on an edge, or at a vertex.
  struct Spot {
    double square;  // of the distance from x
    Vec3 y;
    int face, edge = -1, vertex = -1;
  };

  bool on_segment(const Vec3& x, Vec3& y, Mat3& change) const;
  bool on_cylinder(const Vec3& x, Vec3& y, Mat3& change) const;
  bool on_polytope(const Vec3& x, Vec3& y, Mat3& change);
  double height(int face, const Vec3& x) const;
  bool find_visible(const Vec3& x);
  Spot spot(int face, const Vec3& x) const;
  void try_face(int face, const Vec3& x, Spot& best) const;

  const ShapeFeatures* shape_;
  int face_ = -1;  // of the last point on a polytope
  Place place_;
};

}  // namespace contactvi

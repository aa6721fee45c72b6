// The feature of a convex shape at its nearest point, and how the nearest point moves on it as the normal turns.
//
// A shape is a core swept by a sphere (shape_features.hpp). With the unit normal n out of the core, the point of the
// core that lies farthest along n moves by s = R dn where n turns by dn against the body. R is symmetric, its
// eigenvalues are radii of curvature:
//
//   vertex     0, 0
//   edge       infinite along the edge, 0 across: the normal keeps orthogonal to the edge, and the point slides freely
//   face       infinite, infinite
//   rim        radius of the rim / sine of the angle from its axis to n along the rim, 0 in the plane of n and the axis
//   ellipsoid  see ellipsoid.hpp
//   function   1 / the curvature of the surface; there the turn follows from the slide, as it may be flat
//
// Sweeping by a sphere of radius r adds r dn. The side of a cylinder is its axis swept by its radius, a ball is a
// vertex swept by its radius.
#pragma once

#include "geometry/candidates.hpp"

namespace contactvi {

// Principal directions in the tangent plane, world frame: the slide along e[i] is radius[i] times the turn along it;
// where flat[i], the turn along e[i] is zero and the slide free.
struct Bend {
  Vec3 e[2];
  double radius[2];
  bool flat[2];
  // Where flat[i]: the turn along e[i] is this times the slide [1/m], on a surface that a function gives.
  double curvature[2] = {0.0, 0.0};
};

class ContactSurface {
 public:
  static ContactSurface point(const char* name, const Vec3& x, double sweep);
  // The line through x along the unit vector u.
  static ContactSurface line(const char* name, const Vec3& x, const Vec3& u, double sweep);
  // n: unit, outward.
  static ContactSurface plane(const char* name, const Vec3& x, const Vec3& n, double sweep);
  static ContactSurface rim(const Vec3& center, const Vec3& axis, double radius, const Vec3& outward, double sweep);
  // Of a surface that a function gives, which turns by B dx along dx (FunctionSurface::bend), world frame.
  static ContactSurface curved(const char* name, const Vec3& x, const Mat3& B);
  static ContactSurface ellipsoid(const Ellipsoid& ellipsoid, const Vec3& outward, double sweep);

  // Of a shape, at the point x of its core with the normal `outward`, both in the world. Returns null, or
  // between which features the point lies: there is no single one. nearby: x and the normal are known to some digits
  // only, and the likeliest feature is taken.
  static const char* find(const ShapeFeatures& features, const Pose& pose, const Vec3& x, const Vec3& outward,
                          bool nearby, ContactSurface& found);
  // The feature of this number(), at the point x of it with the outward normal m, both in the frame of the shape. Not
  // of ellipsoids and halfspaces, which have no others.
  static ContactSurface of(const ShapeFeatures& features, const Pose& pose, int number, const Vec3& x, const Vec3& m);

  const char* name() const { return name_; }
  // Within its shape; equal for equal features.
  int number() const { return number_; }
  // The core's point, and the radius of the sphere by which it is swept.
  const Vec3& x() const { return x_; }
  double sweep() const { return sweep_; }
  bool is_point() const { return kind_ == Kind::kPoint; }
  bool is_plane() const { return kind_ == Kind::kPlane; }
  bool is_ellipsoid() const { return kind_ == Kind::kEllipsoid; }

  Bend bend(const Vec3& outward) const;
  // How far `outward` has to turn along the flat direction e to be a normal of the feature.
  double missing_turn(const Vec3& outward, const Vec3& e) const;
  // Moves the point by s to the point of the feature whose normal is `outward`.
  void move(const Vec3& s, const Vec3& outward);

 private:
  enum class Kind : std::uint8_t { kPoint, kLine, kPlane, kRim, kEllipsoid, kCurved };

  static const char* find_on_polytope(const ShapeFeatures& shape, const Pose& pose, const Vec3& x, const Vec3& m,
                                      bool nearby, ContactSurface& found);
  static const char* find_on_cylinder(const ShapeFeatures& shape, const Pose& pose, const Vec3& x, const Vec3& m,
                                      bool nearby, ContactSurface& found);

  Kind kind_ = Kind::kPoint;
  const char* name_ = "";
  int number_ = 0;
  double sweep_ = 0.0, radius_ = 0.0;
  Vec3 x_{}, axis_{}, center_{};  // axis_: direction of the line, normal of the plane, axis of the rim
  Ellipsoid ellipsoid_{};
  Mat3 turning_{};
};

}  // namespace contactvi

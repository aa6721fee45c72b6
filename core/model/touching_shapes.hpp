// The gap of the two shapes of a compliant contact, with its normal and the point at which they press on each other.
//
// Each side is a core that is swept by a sphere. The cores have features: points, lines, planes, rims and ellipsoids.
// Which two of them are nearest is found with plain numbers (nearest_touch), and their gap is a closed form in the
// poses of the bodies (touch), written for any scalar, so that dual numbers give its derivatives. The gap is negative
// where the shapes overlap, also by more than the radii of the spheres.
#pragma once

#include <array>
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "base/dual_number.hpp"
#include "model/placement.hpp"
#include "model/polytope.hpp"

namespace contactvi {

// A part of a core, in the frame of its body.
struct TouchFeature {
  enum class Kind : std::uint8_t { kPoint, kLine, kPlane, kRim, kEllipsoid };
  Kind kind = Kind::kPoint;
  Vec3 p = Vec3::Zero();     // the point; one of the line, of the plane; the centre
  Vec3 u = Vec3::Zero();     // unit: along the line, normal to the plane outward, axis of the rim
  double sweep = 0.0;        // radius of the sphere [m]
  double radius = 0.0;       // of the rim [m]
  Mat3 axes = Mat3::Zero();  // of the ellipsoid: its half axes as columns [m]
};

// The core of one side, in the frame of its body.
struct TouchingShape {
  enum class Kind : std::uint8_t { kPoint, kSegment, kPlane, kPolytope, kCylinder, kEllipsoid };
  Kind kind = Kind::kPoint;
  TouchFeature feature;  // the point, line, plane, axis of the cylinder, or ellipsoid
  double length = 0.0;   // of the segment and of the cylinder, which begin at feature.p [m]
  Polytope polytope;
  std::vector<Vec3> normals = {};  // of its triangles, outward
  Vec3 centre = Vec3::Zero();      // of a ball around it all, of the radius `bound` [m]; infinite for a plane
  double bound = 0.0;
};

struct TouchingShapes {
  TouchingShape a, b;
};

// A pose of a body in the world; without one it is the world's.
template <class T>
struct TouchPose {
  Eigen::Matrix<T, 3, 3> R = Eigen::Matrix<T, 3, 3>::Identity();
  Eigen::Matrix<T, 3, 1> p = Eigen::Matrix<T, 3, 1>::Zero();
};

// In the world: the normal points from b to a, the point is the midpoint of the nearest points.
template <class T>
struct Touch {
  T gap;  // [m]
  Eigen::Matrix<T, 3, 1> normal, point;
};

// The nearest features of both.
struct NearestFeatures {
  TouchFeature a, b;
};
NearestFeatures nearest_touch(const TouchingShapes& shapes, const TouchPose<double>& a, const TouchPose<double>& b);

// A lower bound on the gap [m], from balls around the two shapes.
double least_gap(const TouchingShapes& shapes, const TouchPose<double>& a, const TouchPose<double>& b);

// Contacts of two shapes on bodies, of which there may be several: a shape with corners presses on a plane with each of
// them, a capsule with both ends. reversed: a is the second one.
struct TouchingPair {
  std::shared_ptr<const TouchingShapes> shapes;
  bool reversed;
};

struct Scene;
// Of two geometries of a scene, by their numbers. Throws Refusal where the nearest points of such shapes may jump.
std::vector<TouchingPair> touching_pairs(const Scene& scene, int a, int b, const std::string& name_a,
                                         const std::string& name_b);

// The gap of two features as their bodies are placed.
template <class T>
Touch<T> touch(const TouchFeature& fa, const TouchFeature& fb, const TouchPose<T>& A, const TouchPose<T>& B) {
  using V = Eigen::Matrix<T, 3, 1>;
  using Kind = TouchFeature::Kind;
  using std::sqrt;
  const auto at = [](const TouchPose<T>& P, const Vec3& x) { return V(P.p + P.R * x.cast<T>()); };
  const auto along = [](const TouchPose<T>& P, const Vec3& x) { return V(P.R * x.cast<T>()); };
  const auto unit = [](const V& x) { return V(x / T(sqrt(x.dot(x)))); };
  V ca = at(A, fa.p), cb = at(B, fb.p), n;
  if (fb.kind == Kind::kPlane) {
    n = along(B, fb.u);
    if (fa.kind == Kind::kEllipsoid) {
      const V k = (A.R * fa.axes.cast<T>()).transpose() * n;
      ca -= V((A.R * fa.axes.cast<T>()) * unit(k));
    }
    cb = V(ca - n * n.dot(V(ca - cb)));
  } else if (fa.kind == Kind::kLine && fb.kind == Kind::kLine) {
    const V ua = along(A, fa.u), ub = along(B, fb.u), apart = ca - cb;
    const T c = ua.dot(ub), s = T(1.0) - c * c, da = ua.dot(apart), db = ub.dot(apart);
    ca += V(ua * T((c * db - da) / s));
    cb += V(ub * T((db - c * da) / s));
    n = unit(V(ca - cb));
  } else {
    if (fa.kind == Kind::kLine) {
      const V u = along(A, fa.u);
      ca += V(u * u.dot(V(cb - ca)));
    } else if (fb.kind == Kind::kLine) {
      const V u = along(B, fb.u);
      cb += V(u * u.dot(V(ca - cb)));
    } else if (fb.kind == Kind::kRim) {
      const V w = along(B, fb.u), d = ca - cb;
      cb += V(unit(V(d - w * w.dot(d))) * T(fb.radius));
    }
    n = unit(V(ca - cb));
  }
  const T ra = fa.sweep, rb = fb.sweep;
  return {T(n.dot(V(ca - cb)) - ra - rb), n, V((ca + cb + n * T(rb - ra)) * T(0.5))};
}

}  // namespace contactvi

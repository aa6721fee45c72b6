// Candidates for contact points: which vertices lie over which faces of the other shape, which edges cross.
#pragma once

#include <vector>

#include "geometry/contact_features.hpp"

namespace contactvi {

// The faces on which a and b are nearest, -1: none, and the direction from a to b there.
struct Sides {
  int a = -1, b = -1;
  Vec3 n_W;
};

// Where an edge reaches: its middle and half its length, and along the normal the height of the middle and how far the
// ends are above or below it.
struct Reach {
  Vec3 middle;
  double half, height, rise;
};

// Workspace.
struct NearFeatures {
  std::vector<int> vertices;  // over a face
  std::vector<int> a, b;      // edges
  std::vector<Line> lines_b;
  std::vector<Reach> reaches_b;
};

// Tilt up to which a rim lies flat: R sin(tilt) [m].
constexpr double kUpright = 2e-11;
// How far the common normal of two edges may lie outside of the normals of their faces [rad].
constexpr double kNormalCone = 1e-4;
// Least cosine of a face's normal and the contact's for the face to be one that faces the other body.
constexpr double kFacing = 1e-2;

// upcoming: lists also features that are not near yet but may touch next: edges that cross in the view along n_W, with
// the height of one over the other as their gap, and flat rims by their lowest point instead of by material points.
void list_candidates(const PairView& v, const Sides& sides, bool upcoming, NearFeatures& near, CandidateSink& sink);

// R sin(tilt) [m] of a rim against a plane of the normal n, both in one frame.
inline double rim_tilt(double radius, const Vec3& axis, const Vec3& n) { return radius * axis.cross(n).norm(); }
// The point of a rim that lies deepest along the normal n; a fixed one where it is flat.
Vec3 lowest_of_rim(const Vec3& center, const Vec3& axis, double radius, const Vec3& n);
Vec3 rim_point(const ShapeFeatures::Rim& rim, int k);

// Two lines in the view along n, world frame.
struct Crossing {
  double gap;             // along the common normal of the two
  double height;          // along n
  Vec3 normal;            // unit, n.normal > 0
  Vec3 point_a, point_b;  // nearest points of the two lines, not swept
  double beyond;          // how far these lie beyond the ends of the edges, negative inside
  double beyond_in_view;  // how far the crossing in view lies beyond the ends, negative inside
};
// False where they are nearly parallel in view, or neither their crossing in view nor their nearest points lie within
// `border` of both edges (then c is not complete).
bool cross_lines(const Line& a, const Line& b, const Vec3& n_W, double border, Crossing& c);

}  // namespace contactvi

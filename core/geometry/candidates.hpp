// Candidates for contact points: which vertices lie over which faces of the other shape, which edges cross.
#pragma once

#include <cstdint>

#include "geometry/shape_features.hpp"
#include "model/placement.hpp"

namespace contactvi {

// The kind of a contact feature; stored in trajectories as part of a point's identity: append, never renumber.
enum class Feature : std::uint8_t {
  kWitness = 0,
  kEdges = 1,    // edge i of a across edge j of b
  kVertexB = 2,  // vertex i of b over face j of a; even numbers: of b over a
  kVertexA = 3,  // vertex i of a over face j of b
  kRimB = 4,     // rim i of b over face j of a
  kRimA = 5,
  kRimPointB = 6,  // material point i of b's rims over face j of a
  kRimPointA = 7,
  kRimSideB = 8,  // where rim i of b crosses the side ring[j / 2] of a polygon of a; j odd: the second time
  kRimSideA = 9,
  kEndB = 10,  // an end of edge i / 2 of b over edge j of a that lies along it; i odd: the end that is not its start
  kEndA = 11,
  kRimLineB = 12,  // rim i / 2 of b against edge j of a; i odd: the second place where they are nearest
  kRimLineA = 13,
};

// Material points of one rim; point k of rim i is number i * kRimPoints + k.
constexpr int kRimPoints = 12;

inline std::int64_t feature_number(Feature f, int i, int j) {
  return (static_cast<std::int64_t>(f) << 40) | (static_cast<std::int64_t>(i) << 20) | j;
}
inline Feature feature_kind(std::int64_t n) { return static_cast<Feature>(n >> 40); }
inline int feature_i(std::int64_t n) { return static_cast<int>((n >> 20) & 0xFFFFF); }
inline int feature_j(std::int64_t n) { return static_cast<int>(n & 0xFFFFF); }

inline bool feature_on_b(std::int64_t n) { return (n >> 40) % 2 == 0; }

// The material point at a quarter of the rim of a kRimA or kRimB feature, over the same face.
inline std::int64_t rim_quarter(std::int64_t lowest, int quarter) {
  const Feature kind = feature_on_b(lowest) ? Feature::kRimPointB : Feature::kRimPointA;
  return feature_number(kind, feature_i(lowest) * kRimPoints + quarter * (kRimPoints / 4), feature_j(lowest));
}

// Whether an end of a line, or a rim, lies over a line.
inline bool is_end(Feature f) { return f == Feature::kEndA || f == Feature::kEndB; }
inline bool is_rim_line(Feature f) { return f == Feature::kRimLineA || f == Feature::kRimLineB; }

int feature_rim(std::int64_t n);  // the cylinder's rim that it belongs to, -1: none

struct Candidate {
  std::int64_t feature;
  double gap;
  Vec3 x_W;
};

struct Pose {
  Mat3 R;
  Vec3 p;
  Vec3 point(const Vec3& x) const { return R * x + p; }
  Vec3 into(const Vec3& x_W) const { return R.transpose() * (x_W - p); }
};

Pose pose_of(int body, const Placements& at);

struct PairView {
  const ShapeFeatures *a, *b;
  Pose pose_a, pose_b;
  int body_a, body_b;  // engine joints, -1: world
};

// The faces on which a and b are nearest, -1: none, and the direction from a to b there.
struct Sides {
  int a = -1, b = -1;
  Vec3 n_W;
};

// An edge in the world, swept by the radius.
struct Line {
  Vec3 start, direction;  // direction: unit
  double length, radius;
};

struct EdgeLists {
  std::vector<int> a, b;
  std::vector<Line> lines_b;
};

// How far beyond the border of a face or the end of an edge a point still counts as over it [m]. With 1 mm of rounding
// the error of the gap is then 5e-14 m.
constexpr double kBorder = 1e-8;
// Tilt up to which a rim lies flat: R sin(tilt) [m].
constexpr double kUpright = 2e-11;
// How far the common normal of two edges may lie outside of the normals of their faces [rad].
constexpr double kNormalCone = 1e-4;
// Least cosine of a face's normal and the contact's for the face to be one that faces the other body.
constexpr double kFacing = 1e-2;

class CandidateSink {
 public:
  virtual void add(const Candidate& candidate) = 0;
  double limit = 0;  // candidates with a larger gap are not listed [m]

 protected:
  ~CandidateSink() = default;
};

// upcoming: lists also features that are not near yet but may touch next: edges that cross in the view along n_W, with
// the height of one over the other as their gap, and flat rims by their lowest point instead of by material points.
void list_candidates(const PairView& v, const Sides& sides, bool upcoming, EdgeLists& edges, CandidateSink& sink);

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
Line line_of(const ShapeFeatures& shape_features, const Pose& pose, int edge);
// False where they are nearly parallel in view, or neither their crossing in view nor their nearest points lie within
// `border` of both edges (then c is not complete).
bool cross_lines(const Line& a, const Line& b, const Vec3& n_W, double border, Crossing& c);
// How far the common normal of two edges lies outside of the normals of the edges' faces [rad], negative inside.
double outside_cone(const PairView& v, int edge_a, int edge_b, const Vec3& normal_W);

}  // namespace contactvi

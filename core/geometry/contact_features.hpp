// The features at which the two shapes of a pair may touch: their numbers, the pair as it is placed, and its lines.
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
  kSolidsB = 14,  // common normal j, from a to b; i: the part of a cylinder (model/cylinder_normals.hpp)
  kSolidsA = 15,
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

// An edge in the world, swept by the radius.
struct Line {
  Vec3 start, direction;  // direction: unit
  double length, radius;
};

// How far beyond the border of a face or the end of an edge a point still counts as over it [m]. With edges rounded
// by 1e-6 m the error of the gap is then 2e-12 m.
constexpr double kBorder = 3e-9;
class CandidateSink {
 public:
  virtual void add(const Candidate& candidate) = 0;
  double limit = 0;    // candidates with a larger gap are not listed [m]
  bool falls = false;  // the limit, to the gap of what was added

 protected:
  ~CandidateSink() = default;
};

Line line_of(const ShapeFeatures& shape_features, const Pose& pose, int edge);
// How far the common normal of two edges lies outside of the normals of the edges' faces [rad], negative inside.
double outside_cone(const PairView& v, int edge_a, int edge_b, const Vec3& normal_W);

}  // namespace contactvi

// The vertices of a large hull that lie farthest along a direction, found from edge to edge instead of among all.
//
// On a convex polytope a vertex with no neighbour that lies farther is the farthest one, and the vertices beyond a
// plane hang together by edges (Ziegler, "Lectures on Polytopes", 1995, section 3.2). Faces that are flat but for
// rounding make hulls convex up to their roughness only: what lies nearer than that to the farthest vertex is looked
// at, too. Answers are those of a look at all vertices, the first of several that are equally far among them.
#pragma once

#include <array>
#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

class HullWalk {
 public:
  // Vertices that list() gives at most.
  static constexpr int kMost = 32;
  struct List {
    std::array<int, kMost> vertices;
    int count = 0;
    bool holds(int v) const;
  };

  // No walk: for few vertices a look at all is quicker.
  HullWalk() = default;
  // ends: pairs of vertices with an edge between them.
  HullWalk(const std::vector<Vec3>& vertices, const std::vector<std::array<int, 2>>& ends, double roughness);

  bool none() const { return first_.empty(); }
  // The vertex farthest along the unit vector m; -1 where too many are nearly so.
  int farthest(const std::vector<Vec3>& vertices, const Vec3& m) const;
  // The vertices x with m.x >= least, and some that miss it by the roughness, ascending; farthest: of these. False
  // where they are more than kMost.
  bool list(const std::vector<Vec3>& vertices, const Vec3& m, int farthest, double least, List& found) const;

 private:
  int climb(const std::vector<Vec3>& vertices, const Vec3& m, int from) const;
  bool spread(const std::vector<Vec3>& vertices, const Vec3& m, double least, List& found) const;

  static constexpr int kCells = 8;  // of one side of the cube of directions, along an edge
  double slack_ = 0.0;  // [m] by which a vertex without a farther neighbour may be less far than another one
  std::vector<int> first_, neighbors_;
  std::vector<int> starts_;  // per cell: a vertex near the farthest one
};

}  // namespace contactvi

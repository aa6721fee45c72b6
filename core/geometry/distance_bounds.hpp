// Bounds on the distance of two convex shapes that cost a small part of the distance itself, from what its last
// evaluation has found: the direction of the shortest line, and the ends of that.
//
// Along any direction the gap between the extents of the two shapes is a lower bound on their distance, and any point
// of the one is farther from a point of the other than that. Both hold wherever the shapes are, and are near to the
// distance where the shapes have turned little since. The direction is kept in the frames of both: that of a face
// turns with the shape that has the face.
#pragma once

#include <memory>
#include <vector>

#include "geometry/contact.hpp"

namespace coal {
class CollisionGeometry;
}

namespace contactvi {

// A shape, whose frame is (R, p) in the world.
struct PosedShape {
  const coal::CollisionGeometry* shape;
  Mat3 R;
  Vec3 p;
};

class DistanceBounds {
 public:
  explicit DistanceBounds(std::size_t pairs);
  ~DistanceBounds();

  // Lower: minus infinity where nothing is known of the pair [m].
  struct Bounds {
    double lower, upper;
  };
  // Keeps what an evaluation of the pair's distance has found.
  void keep(int pair, const PosedShape& a, const PosedShape& b, const Contact& contact);
  Bounds find(int pair, const PosedShape& a, const PosedShape& b);
  // Whether an evaluation would hardly give more than the lower bound.
  static bool is_close(const Bounds& bounds) { return bounds.lower >= kClose * bounds.upper; }
  void forget();

 private:
  static constexpr double kClose = 0.875;  // so that an evaluation lengthens no span by more than a seventh
  // In the frames of the shapes: the direction from a to b, and the ends of the shortest line. And of hulls the
  // vertices that were the farthest ones along it, from where the search for those goes on.
  struct Known {
    int pair = -1;
    Vec3 direction_a, direction_b, point_a, point_b;
    int vertex_a = 0, vertex_b = 0;
  };
  Known& place_of(int pair) { return known_[pair & (known_.size() - 1)]; }
  double extent(const PosedShape& shape, const Vec3& direction_W, int& vertex);

  std::vector<Known> known_;  // of a pair at its number, less multiples of the size: the last one there
  struct Workspace;           // coal's, kept out of this header
  std::unique_ptr<Workspace> workspace_;
};

}  // namespace contactvi

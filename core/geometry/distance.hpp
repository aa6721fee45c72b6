// The distance of two convex shapes by coal.
#pragma once

#include <memory>

#include "geometry/contact.hpp"

namespace coal {
class CollisionGeometry;
}

namespace contactvi {

// To be called before coal first evaluates a box: it inflates all boxes of a process by 1e-10 of their size if the
// direction of that very first query has a zero component (a static variable in its support function), so distances
// would depend on earlier queries of the process.
void settle_box_support();

// One workspace of coal serves all pairs of a scene: one per pair would take 2 kB each. It starts from the same guess
// each time, so that a distance depends on the two poses alone and not on what was asked before.
class ShapeDistance {
 public:
  ShapeDistance();
  ~ShapeDistance();

  // Of shape a, whose frame is (R_a, p_a) in the world, from shape b: gap [m], normal from a to b and nearest points.
  // The gap is not finite if coal fails. The bodies of `contact` stay as they are.
  void evaluate(const coal::CollisionGeometry& a, const Mat3& R_a, const Vec3& p_a, const coal::CollisionGeometry& b,
                const Mat3& R_b, const Vec3& p_b, Contact& contact);

 private:
  struct Workspace;  // coal's, kept out of this header
  std::unique_ptr<Workspace> workspace_;
};

}  // namespace contactvi

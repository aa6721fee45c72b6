// PLACEHOLDER of LEAD until MANIFOLD delivers: overwrite.
#pragma once
#include <cstdint>
#include <limits>
#include <vector>

#include "contact.hpp"
#include "scene.hpp"

namespace contactvi {
enum class PointKind : std::uint8_t { kWitness, kVertex, kRim, kLimit };
struct ContactPoint {
  int guard;
  PointKind kind;
  std::int64_t feature;
  bool material;
  bool on_b;
  int point_body, plane_body;
  Vec3 center_B;
  double radius;
  Vec3 normal_B;
  double offset;
  Vec3 axis_B;
  double rim_radius;
};
class Manifolds {
 public:
  Manifolds(const Scene&, int) {}
  void find(int pair, const Placements&, const Contact& witness, double margin, std::vector<ContactPoint>& out) const {
    if (!(witness.gap <= margin)) return;
    ContactPoint p{};
    p.guard = pair;
    p.kind = PointKind::kWitness;
    out.push_back(p);
  }
  void evaluate(const ContactPoint&, const Placements&, Contact&) const {}
  bool valid(const ContactPoint&, const Placements&) const { return true; }
  double rest(int, const Placements&, const ContactPoint* const*, int, const Contact&, Contact&) const {
    return std::numeric_limits<double>::infinity();
  }
};
}  // namespace contactvi

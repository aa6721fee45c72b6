// Seams: where shapes that are fixed to one body touch each other, their union may have no edge.
//
// Two flush tiles are one plate, and so are two pieces of a mesh or two prisms of a height field. But each of them has
// edges of its own, and what slides over one tile closes with the edge of the next one along a tilted normal, just
// before it is over it. A unit vector m is a normal of a union of convex shapes at a place x of several of them only if
// it is one of each of them there: a small ball that touches the union in x touches each shape that holds x (proximal
// normals; Clarke, Ledyaev, Stern, Wolenski, "Nonsmooth Analysis and Control Theory", 1998, section 1.1). So where a
// neighbour holds the nearest point x of a shape and reaches beyond x along the normal there, the place is an inner one
// of the union: the neighbour is nearer, and has a pair of its own.
//
// Such a place is not left out, because the distance of a pair has to be bounded by motion. Its gap counts as larger
// by how far the neighbour reaches beyond it, and at most by the rounding of features (kFeatureRounding), which is how
// deep what persists on the neighbour may be. Then a pair closes where its place is one of the union, in one way with
// the neighbour's, and nowhere later than by that rounding: where shapes are not flush, gaps are 1e-10 m off.
#pragma once

#include <vector>

#include "geometry/contact.hpp"
#include "geometry/pair_table.hpp"
#include "model/scene.hpp"

namespace contactvi {

class Seams {
 public:
  explicit Seams(const Scene& scene);

  // Whether a shape of the pair has a neighbour on its body.
  bool any(int pair) const {
    return !near_.empty() && (has_any(scene_->pairs[pair].a) || has_any(scene_->pairs[pair].b));
  }
  // By how much the gap of a pair that has this contact counts as larger [m].
  double slack(int pair, const Placements& at, const Contact& contact) const;
  // Gaps from here on are not asked for [m].
  static constexpr double kNear = 1e-8;
  // Whether the crossing at x of an edge of the pair's a along u_a with one of b along u_b, unit vectors, lies within a
  // flat side of a union, and one of the two edges goes on over the neighbour there. n: from a to b. Such a crossing is
  // no end of what touches.
  bool goes_on(int pair, const Placements& at, const Vec3& x_W, const Vec3& n_W, const Vec3& u_a,
               const Vec3& u_b) const;

 private:
  bool has_any(int geometry) const { return start_[geometry] < start_[geometry + 1]; }
  bool goes_on_over(int other, int geometry, bool rounded, const Placements& at, const Vec3& x_W, const Vec3& m_W,
                    const Vec3& u_W) const;
  double beyond(int other, int geometry, const Placements& at, const Vec3& x_W, const Vec3& m_W) const;

  const Scene* scene_;
  PairTable pairs_;
  // Neighbours of geometry g: near_[start_[g] .. start_[g + 1]).
  std::vector<int> start_, near_;
};

}  // namespace contactvi

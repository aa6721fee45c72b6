// Vertices of a polytope with more neighbours than coal can count, such as the apex of a cone with hundreds of sides.
//
// Coal looks for the vertex of a polytope that is farthest in a direction by going from each vertex to the best of its
// neighbours, and has eight bits for their number. This finds the farthest one where the neighbours of each vertex are
// those at the other ends of its edges; sides of triangles between two of the same plane are not needed for it. Where
// the edges themselves are too many, the vertex gets helpers in their place, points next to it, each of which has a
// share of its neighbours. Planes of some of the faces around the vertex are chosen; a helper lies on the line in which
// one of them meets the next, so that what lies between the two in the polytope lies inside of the helpers. They are
// the neighbours of the vertex in the hull of all.
//
// A helper is at most kOutside of the polytope's size outside of it. What the search misses for rounding is of the same
// size: differences of 1e-16 over the distance of the helpers.
#pragma once

#include <vector>

#include "base/numerics.hpp"
#include "model/polytope.hpp"

namespace contactvi {

constexpr std::size_t kMostNeighbors = 254;  // that coal can count
constexpr int kMostShared = 40000;           // neighbours that helpers can share
// Bound on the error of a distance from a vertex with helpers, in sizes of the polytope.
constexpr double kOutside = 1e-9;

// A vertex that gets helpers, and these. Without any helper the vertex keeps the neighbours `own`.
struct CrowdedVertex {
  std::vector<unsigned> own;
  std::vector<Vec3> helpers;
  std::vector<std::vector<unsigned>> neighbors;  // of each helper: vertices of the polytope
};

// Shares out the neighbours of a vertex of a polytope; all of them are given, ascending.
CrowdedVertex share_out(const Polytope& polytope, unsigned vertex, const std::vector<unsigned>& all);

// At most kMostNeighbors of them, evenly chosen.
std::vector<unsigned> some_of(const std::vector<unsigned>& all);

}  // namespace contactvi

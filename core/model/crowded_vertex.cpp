#include "model/crowded_vertex.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <unordered_map>

#include "base/refusal.hpp"

namespace contactvi {

namespace {

// Faces whose normals differ by less are one plane: what that changes is this part of the size.
constexpr double kFlat = 1e-10;
// Distance of helpers from their vertex in sizes of the polytope: those of a cone of many sides are outside of it by
// 4e-5 of that at most, and a difference of 1e-16 of the size over this is what the search misses.
constexpr double kNear = 1e-6;
constexpr double kOfShortest = 0.1;  // and at most this part of the shortest edge
// Helpers of a cone whose sides are alike, and the most of any vertex: the others are for sides of very different sizes.
constexpr std::size_t kHelpers = 180, kMostHelpers = 240;
// Between two chosen faces at least one of these is reached: the angle between their normals, that between the edges.
constexpr double kTurn = 0.15;

// An edge between the vertex and a neighbour, and the normal of the face anticlockwise behind it, seen from outside.
struct Spoke {
  unsigned end;
  Vec3 along;  // unit vector from the vertex
  Vec3 normal;
};

Vec3 point(const Polytope& polytope, unsigned i) { return polytope.vertices.row(i); }

// The spokes of a vertex in their order around it; none where the triangles do not close around it.
std::vector<Spoke> spokes_of(const Polytope& polytope, unsigned vertex, std::size_t count) {
  std::unordered_map<unsigned, unsigned> next;
  unsigned first = 0;
  for (Eigen::Index f = 0; f < polytope.faces.rows(); ++f)
    for (int k = 0; k < 3; ++k)
      if (static_cast<unsigned>(polytope.faces(f, k)) == vertex) {
        first = static_cast<unsigned>(polytope.faces(f, (k + 1) % 3));
        next[first] = static_cast<unsigned>(polytope.faces(f, (k + 2) % 3));
      }
  std::vector<Spoke> spokes;
  const Vec3 at = point(polytope, vertex);
  unsigned i = first;
  do {
    const auto found = next.find(i);
    if (found == next.end() || spokes.size() == count) return {};
    const Vec3 a = point(polytope, i) - at, b = point(polytope, found->second) - at;
    const Vec3 n = a.cross(b);
    const bool has_normal = n.norm() > 1e-13 * a.norm() * b.norm();
    spokes.push_back({i, a.normalized(), has_normal ? n.normalized() : Vec3(Vec3::Zero())});
    i = found->second;
  } while (i != first);
  if (spokes.size() != count) return {};
  // A face without a normal is part of the one before it.
  for (std::size_t k = 0; k < 2 * count; ++k)
    if (Spoke& s = spokes[k % count]; s.normal.isZero(0.0)) s.normal = spokes[(k + count - 1) % count].normal;
  return spokes;
}

// The spokes that are edges: the others lie between triangles of one plane.
std::vector<Spoke> edges_among(const std::vector<Spoke>& spokes) {
  const std::size_t count = spokes.size();
  const auto before = [&](std::size_t k) { return (k + count - 1) % count; };
  std::size_t sharpest = 0;
  double most = 0.0;
  for (std::size_t k = 0; k < count; ++k)
    if (const double turn = (spokes[k].normal - spokes[before(k)].normal).norm(); turn > most) {
      most = turn;
      sharpest = k;
    }
  std::vector<Spoke> edges;
  if (!(most > kFlat)) return edges;
  for (std::size_t k = 0; k < count; ++k) {
    const Spoke& s = spokes[(sharpest + k) % count];
    if (edges.empty() || (s.normal - edges.back().normal).norm() > kFlat) edges.push_back(s);
  }
  return edges;
}

// Numbers of the edges behind which there are the chosen faces, ascending from 0.
std::vector<std::size_t> choose_faces(const std::vector<Spoke>& edges) {
  const std::size_t count = edges.size(), share = (count + kHelpers - 1) / kHelpers;
  std::vector<std::size_t> chosen;
  for (double turn = kTurn;; turn *= 1.5) {
    chosen.clear();
    for (std::size_t at = 0; at < count;) {
      chosen.push_back(at);
      std::size_t to = at + 1;
      while (to + 1 < count && to - at < share && (edges[to + 1].normal - edges[at].normal).norm() < turn &&
             (edges[to + 1].along - edges[at + 1].along).norm() < turn)
        ++to;
      at = to;
    }
    if (chosen.size() <= kMostHelpers || turn > 1.0) return chosen;
  }
}

}  // namespace

std::vector<unsigned> some_of(const std::vector<unsigned>& all) {
  if (all.size() <= kMostNeighbors) return all;
  std::vector<unsigned> some(kMostNeighbors);
  for (std::size_t k = 0; k < some.size(); ++k) some[k] = all[k * all.size() / some.size()];
  return some;
}

CrowdedVertex share_out(const Polytope& polytope, unsigned vertex, const std::vector<unsigned>& all) {
  const std::vector<Spoke> spokes = spokes_of(polytope, vertex, all.size());
  // Triangles that do not close around a vertex are slivers of the rounding; it is no corner of its own then.
  if (spokes.empty()) return {some_of(all), {}, {}};
  const std::vector<Spoke> edges = edges_among(spokes);
  if (edges.size() <= kMostHelpers) {
    std::vector<unsigned> ends;
    for (const Spoke& edge : edges) ends.push_back(edge.end);
    if (ends.size() < 3) ends = all;
    std::sort(ends.begin(), ends.end());
    return {some_of(ends), {}, {}};
  }
  const std::vector<std::size_t> chosen = choose_faces(edges);
  const std::size_t count = edges.size();
  const Vec3 at = point(polytope, vertex);
  double shortest = std::numeric_limits<double>::infinity();
  for (const Spoke& edge : edges) shortest = std::min(shortest, (point(polytope, edge.end) - at).norm());
  const double size = (polytope.vertices.colwise().maxCoeff() - polytope.vertices.colwise().minCoeff()).norm();
  const double distance = std::min(kNear * size, kOfShortest * shortest);
  CrowdedVertex result;
  for (std::size_t a = 0; a < chosen.size(); ++a) {
    const std::size_t from = chosen[a], to = a + 1 < chosen.size() ? chosen[a + 1] : count + chosen[0];
    std::vector<unsigned> ends;
    Vec3 along = Vec3::Zero();
    for (std::size_t k = from + 1; k <= to; ++k) {
      ends.push_back(edges[k % count].end);
      along += edges[k % count].along;
    }
    if (to - from > 1) {
      const Vec3 line = edges[from].normal.cross(edges[to % count].normal);
      if (line.norm() > 0.0) along = line.dot(along) < 0.0 ? -line : line;
    }
    result.helpers.push_back(at + distance * along.normalized());
    result.neighbors.push_back(std::move(ends));
  }
  const std::size_t most = kMostNeighbors - 3;  // The vertex and the helpers at both sides come on top.
  for (const std::vector<unsigned>& ends : result.neighbors)
    if (ends.size() > most || result.helpers.size() > kMostNeighbors)
      throw Refusal("A vertex of a convex hull has too many neighbours", "at most " + std::to_string(kHelpers * most),
                    std::to_string(all.size()), "Simplify the mesh, or replace it by a cylinder, a ball or a box");
  return result;
}

}  // namespace contactvi

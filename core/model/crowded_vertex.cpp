#include "model/crowded_vertex.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <unordered_map>

namespace contactvi {

namespace {

// Points that are nearer to a plane than this part of the size lie in it.
constexpr double kFlat = 1e-10;
// Distance of helpers from their vertex in sizes of the polytope: those of a cone of many sides are outside of it by
// 4e-5 of that at most, and a difference of 1e-16 of the size over this is what the search misses.
constexpr double kNear = 1e-6;
constexpr double kOfShortest = 0.1;  // and at most this part of the shortest edge
// Helpers of a cone whose sides are alike, and the most of any vertex: the others are for sides of very different
// sizes.
constexpr std::size_t kHelpers = 180, kMostHelpers = 240;
// A helper's own: the vertex and the helpers at both sides come on top.
constexpr std::size_t kMostOfHelper = kMostNeighbors - 3;
static_assert(kMostShared <= static_cast<int>(kHelpers * kMostOfHelper));
// Between two chosen faces at least one of these is reached: the angle between their normals, that between the edges.
constexpr double kTurn = 0.15;

using Points = std::vector<Vec3>;

// An edge between the vertex and a neighbour, and the normal of the face behind it.
struct Edge {
  unsigned end;
  Vec3 along;  // unit vector from the vertex
  Vec3 normal;
};

Vec3 point(const Polytope& polytope, unsigned i) { return polytope.vertices.row(i); }

// The neighbours of a vertex in their order around it, one way or the other: the triangles of the rounding may be
// turned the wrong way. None where the triangles do not close around it.
std::vector<unsigned> ring_of(const Polytope& polytope, unsigned vertex, std::size_t count) {
  std::unordered_map<unsigned, std::array<unsigned, 2>> beside;  // of each neighbour, the ones before and behind
  std::unordered_map<unsigned, int> found;
  unsigned first = 0;
  const auto join = [&](unsigned i, unsigned j) {
    const int k = found[i]++;
    if (k < 2) beside[i][k] = j;
  };
  for (Eigen::Index f = 0; f < polytope.faces.rows(); ++f)
    for (int k = 0; k < 3; ++k)
      if (static_cast<unsigned>(polytope.faces(f, k)) == vertex) {
        first = static_cast<unsigned>(polytope.faces(f, (k + 1) % 3));
        const auto second = static_cast<unsigned>(polytope.faces(f, (k + 2) % 3));
        join(first, second);
        join(second, first);
      }
  for (const auto& [i, triangles] : found)
    if (triangles != 2) return {};
  std::vector<unsigned> ring = {first};
  for (unsigned i = beside[first][0], last = first; i != first && ring.size() <= count;) {
    ring.push_back(i);
    const std::array<unsigned, 2>& both = beside[i];
    const unsigned next = both[0] == last ? both[1] : both[0];
    last = i;
    i = next;
  }
  return ring.size() == count ? ring : std::vector<unsigned>();
}

// The edges of a vertex in their order around it. Neighbouring triangles whose corners are as good as in one plane are
// one face, with the normal of the largest of them: normals of small ones are lost in the rounding.
std::vector<Edge> edges_of(const Polytope& polytope, unsigned vertex, const std::vector<unsigned>& ring, double size) {
  const auto count = static_cast<int>(ring.size());
  const auto at = [&](int k) { return static_cast<std::size_t>((k + count) % count); };
  const Vec3 origin = point(polytope, vertex);
  Points spokes, areas;
  for (unsigned i : ring) spokes.push_back(point(polytope, i) - origin);
  for (int k = 0; k < count; ++k) areas.push_back(spokes[k].cross(spokes[at(k + 1)]));
  std::vector<int> order(count), face(count, -1);  // the triangles, largest first, and the face of each
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int i, int j) { return areas[i].norm() > areas[j].norm(); });
  Points normals;
  for (const int seed : order) {
    if (face[seed] >= 0) continue;
    const auto number = static_cast<int>(normals.size());
    normals.push_back(areas[seed].normalized());
    const auto take = [&](int triangle, int corner) {
      if (face[at(triangle)] >= 0 || !(std::abs(normals.back().dot(spokes[at(corner)])) <= kFlat * size)) return false;
      face[at(triangle)] = number;
      return true;
    };
    face[seed] = number;
    for (int k = seed + 1; take(k, k + 1); ++k) continue;
    for (int k = seed - 1; take(k, k); --k) continue;
  }
  std::vector<Edge> edges;
  for (int k = 0; k < count; ++k)
    if (face[k] != face[at(k - 1)]) edges.push_back({ring[k], spokes[k].normalized(), normals[face[k]]});
  return edges;
}

// Numbers of the edges behind which there are the chosen faces, ascending from 0.
std::vector<std::size_t> choose_faces(const std::vector<Edge>& edges) {
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
  const std::vector<unsigned> ring = ring_of(polytope, vertex, all.size());
  // Triangles that do not close around a vertex are slivers of the rounding; it is no corner of its own then.
  if (ring.empty()) return {some_of(all), {}, {}};
  const double size = (polytope.vertices.colwise().maxCoeff() - polytope.vertices.colwise().minCoeff()).norm();
  const std::vector<Edge> edges = edges_of(polytope, vertex, ring, size);
  if (edges.size() <= kMostHelpers) {
    std::vector<unsigned> ends;
    for (const Edge& edge : edges) ends.push_back(edge.end);
    if (ends.size() < 3) ends = all;
    std::sort(ends.begin(), ends.end());
    return {some_of(ends), {}, {}};
  }
  const std::vector<std::size_t> chosen = choose_faces(edges);
  const std::size_t count = edges.size();
  const Vec3 at = point(polytope, vertex);
  double shortest = std::numeric_limits<double>::infinity();
  for (const Edge& edge : edges) shortest = std::min(shortest, (point(polytope, edge.end) - at).norm());
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
    if (ends.size() > kMostOfHelper) ends.resize(kMostOfHelper);  // no more than kMostShared neighbours come here
    result.neighbors.push_back(std::move(ends));
  }
  return result;
}

}  // namespace contactvi

#include "model/polytope.hpp"

#include <coal/shape/convex.h>

#include <algorithm>
#include <limits>
#include <vector>

#include "base/error.hpp"

namespace contactvi {

namespace {

// Coal's polytope with neighbours found by sorting. Coal's constructor finds them with a tree of nodes for each vertex,
// which takes ten times as long.
class SortedPolytope final : public coal::Convex<coal::Triangle> {
 public:
  explicit SortedPolytope(const Polytope& polytope) {
    auto vertices = std::make_shared<std::vector<coal::Vec3s>>();
    vertices->reserve(polytope.vertices.rows());
    for (Eigen::Index i = 0; i < polytope.vertices.rows(); ++i) vertices->push_back(polytope.vertices.row(i));
    polygons = std::make_shared<std::vector<coal::Triangle>>();
    polygons->reserve(polytope.faces.rows());
    for (Eigen::Index i = 0; i < polytope.faces.rows(); ++i)
      polygons->emplace_back(polytope.faces(i, 0), polytope.faces(i, 1), polytope.faces(i, 2));
    num_polygons = static_cast<unsigned>(polygons->size());
    initialize(vertices, static_cast<unsigned>(vertices->size()));
    find_neighbors();
    buildSupportWarmStart();
  }

 private:
  // Neighbours of each vertex, ascending: the other corners of its triangles.
  void find_neighbors() {
    std::vector<std::size_t> start(num_points + 1, 0);  // of each vertex in `found`
    for (const coal::Triangle& t : *polygons)
      for (int k = 0; k < 3; ++k) start[t[k] + 1] += 2;
    for (unsigned i = 0; i < num_points; ++i) start[i + 1] += start[i];
    std::vector<unsigned> found(start.back());
    std::vector<std::size_t> end(start.begin(), start.end() - 1);
    for (const coal::Triangle& t : *polygons)
      for (int k = 0; k < 3; ++k) {
        found[end[t[k]]++] = static_cast<unsigned>(t[(k + 1) % 3]);
        found[end[t[k]]++] = static_cast<unsigned>(t[(k + 2) % 3]);
      }
    nneighbors_ = std::make_shared<std::vector<unsigned>>();
    nneighbors_->reserve(found.size() / 2);  // In a closed surface each edge of a vertex is one of two triangles.
    std::vector<std::size_t> first(num_points);
    neighbors = std::make_shared<std::vector<Neighbors>>(num_points);
    for (unsigned i = 0; i < num_points; ++i) {
      const auto own = found.begin() + start[i];
      std::sort(own, found.begin() + end[i]);
      const auto last = std::unique(own, found.begin() + end[i]);
      if (last - own >= std::numeric_limits<unsigned char>::max()) throw Error("a vertex has too many neighbours");
      (*neighbors)[i].count_ = static_cast<unsigned char>(last - own);
      first[i] = nneighbors_->size();
      nneighbors_->insert(nneighbors_->end(), own, last);
    }
    for (unsigned i = 0; i < num_points; ++i) (*neighbors)[i].n_ = nneighbors_->data() + first[i];
  }
};

}  // namespace

std::shared_ptr<coal::CollisionGeometry> shape_of(const Polytope& polytope) {
  const auto& faces = polytope.faces;
  if (faces.size() > 0 && (faces.minCoeff() < 0 || faces.maxCoeff() >= polytope.vertices.rows()))
    throw Error("a triangle of a hull has a corner that is no vertex");
  return std::make_shared<SortedPolytope>(polytope);
}

}  // namespace contactvi

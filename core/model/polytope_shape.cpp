#include "model/polytope_shape.hpp"

#include <coal/shape/convex.h>

#include <algorithm>
#include <utility>
#include <vector>

#include "base/error.hpp"
#include "model/crowded_vertex.hpp"

namespace contactvi {

namespace {

// The neighbours of vertices, one list after the other.
class NeighborLists {
 public:
  void add(const unsigned* begin, const unsigned* end) {
    all_.insert(all_.end(), begin, end);
    end_.push_back(all_.size());
  }
  void add(const std::vector<unsigned>& list) { add(list.data(), list.data() + list.size()); }
  void reserve(std::size_t vertices, std::size_t neighbors) {
    end_.reserve(vertices);
    all_.reserve(neighbors);
  }

  std::size_t size() const { return end_.size(); }
  std::size_t first(std::size_t i) const { return i == 0 ? 0 : end_[i - 1]; }
  std::size_t count(std::size_t i) const { return end_[i] - first(i); }
  const std::vector<unsigned>& all() const { return all_; }

 private:
  std::vector<unsigned> all_;
  std::vector<std::size_t> end_;
};

// Neighbours of each vertex, ascending: the other corners of its triangles. Found by sorting; coal's constructor finds
// them with a tree of nodes for each vertex, which takes ten times as long.
class Neighbors {
 public:
  explicit Neighbors(const Polytope& polytope) : start_(polytope.vertices.rows() + 1, 0) {
    const auto& faces = polytope.faces;
    for (Eigen::Index f = 0; f < faces.rows(); ++f)
      for (int k = 0; k < 3; ++k) start_[faces(f, k) + 1] += 2;
    for (std::size_t i = 0; i + 1 < start_.size(); ++i) start_[i + 1] += start_[i];
    found_.resize(start_.back());
    end_.assign(start_.begin(), start_.end() - 1);
    for (Eigen::Index f = 0; f < faces.rows(); ++f)
      for (int k = 0; k < 3; ++k) {
        found_[end_[faces(f, k)]++] = static_cast<unsigned>(faces(f, (k + 1) % 3));
        found_[end_[faces(f, k)]++] = static_cast<unsigned>(faces(f, (k + 2) % 3));
      }
    for (std::size_t i = 0; i < end_.size(); ++i) {
      const auto own = found_.begin() + start_[i], last = found_.begin() + end_[i];
      std::sort(own, last);
      end_[i] = static_cast<std::size_t>(std::unique(own, last) - found_.begin());
    }
  }

  std::size_t size() const { return end_.size(); }
  std::size_t total() const { return found_.size() / 2; }  // In a closed surface each edge is one of two triangles.
  const unsigned* begin(std::size_t i) const { return found_.data() + start_[i]; }
  const unsigned* end(std::size_t i) const { return found_.data() + end_[i]; }
  bool crowded(std::size_t i) const { return end_[i] - start_[i] > kMostNeighbors; }

 private:
  std::vector<std::size_t> start_, end_;  // of each vertex in `found_`
  std::vector<unsigned> found_;
};

// Coal's polytope, with `helpers` or without (shape_of, plain_shape_of).
class SortedPolytope final : public coal::Convex<coal::Triangle> {
 public:
  SortedPolytope(const Polytope& polytope, bool helpers) {
    auto vertices = std::make_shared<std::vector<coal::Vec3s>>();
    vertices->reserve(polytope.vertices.rows());
    for (Eigen::Index i = 0; i < polytope.vertices.rows(); ++i) vertices->push_back(polytope.vertices.row(i));
    polygons = std::make_shared<std::vector<coal::Triangle>>();
    polygons->reserve(polytope.faces.rows());
    for (Eigen::Index i = 0; i < polytope.faces.rows(); ++i)
      polygons->emplace_back(polytope.faces(i, 0), polytope.faces(i, 1), polytope.faces(i, 2));
    num_polygons = static_cast<unsigned>(polygons->size());
    const NeighborLists lists = list_neighbors(polytope, helpers, *vertices);
    initialize(vertices, static_cast<unsigned>(vertices->size()));
    nneighbors_ = std::make_shared<std::vector<unsigned>>(lists.all());
    neighbors = std::make_shared<std::vector<coal::ConvexBase::Neighbors>>(lists.size());
    for (std::size_t i = 0; i < lists.size(); ++i) {
      (*neighbors)[i].count_ = static_cast<unsigned char>(lists.count(i));
      (*neighbors)[i].n_ = nneighbors_->data() + lists.first(i);
    }
    buildSupportWarmStart();
  }

 private:
  // The lists of the vertices and of their helpers, which are added to the vertices.
  static NeighborLists list_neighbors(const Polytope& polytope, bool helpers, std::vector<coal::Vec3s>& vertices) {
    const contactvi::Neighbors found(polytope);
    NeighborLists lists;
    lists.reserve(found.size(), found.total());
    std::vector<std::vector<unsigned>> of_helpers;
    for (std::size_t i = 0; i < found.size(); ++i) {
      if (!found.crowded(i)) {
        lists.add(found.begin(i), found.end(i));
        continue;
      }
      const std::vector<unsigned> all(found.begin(i), found.end(i));
      const auto vertex = static_cast<unsigned>(i);
      if (helpers)
        lists.add(add_helpers(vertex, share_out(polytope, vertex, all), vertices, of_helpers));
      else
        lists.add(some_of(all));
    }
    for (const std::vector<unsigned>& list : of_helpers) lists.add(list);
    return lists;
  }

  // Adds the helpers of a vertex behind the vertices, and their neighbours to `lists`. Returns those of the vertex.
  static std::vector<unsigned> add_helpers(unsigned vertex, const CrowdedVertex& crowded,
                                           std::vector<coal::Vec3s>& vertices,
                                           std::vector<std::vector<unsigned>>& lists) {
    std::vector<unsigned> own = crowded.own;
    const auto first = static_cast<unsigned>(vertices.size()), count = static_cast<unsigned>(crowded.helpers.size());
    for (unsigned a = 0; a < count; ++a) {
      own.push_back(first + a);
      std::vector<unsigned> list = crowded.neighbors[a];
      for (unsigned other : {vertex, first + (a + 1) % count, first + (a + count - 1) % count}) list.push_back(other);
      lists.push_back(std::move(list));
      vertices.push_back(crowded.helpers[a]);
    }
    return own;
  }
};

void check_corners(const Polytope& polytope) {
  const auto& faces = polytope.faces;
  if (faces.size() > 0 && (faces.minCoeff() < 0 || faces.maxCoeff() >= polytope.vertices.rows()))
    throw Error("a triangle of a hull has a corner that is no vertex");
}

}  // namespace

std::shared_ptr<coal::CollisionGeometry> shape_of(const Polytope& polytope) {
  check_corners(polytope);
  return std::make_shared<SortedPolytope>(polytope, true);
}

std::shared_ptr<coal::CollisionGeometry> plain_shape_of(const Polytope& polytope) {
  check_corners(polytope);
  return std::make_shared<SortedPolytope>(polytope, false);
}

int most_neighbors(const Polytope& polytope) {
  check_corners(polytope);
  const Neighbors found(polytope);
  std::ptrdiff_t most = 0;
  for (std::size_t i = 0; i < found.size(); ++i) most = std::max(most, found.end(i) - found.begin(i));
  return static_cast<int>(most);
}

int count_crowded(const Polytope& polytope) {
  check_corners(polytope);
  const Neighbors found(polytope);
  int count = 0;
  for (std::size_t i = 0; i < found.size(); ++i)
    if (found.crowded(i)) {
      const auto vertex = static_cast<unsigned>(i);
      const std::vector<unsigned> all(found.begin(i), found.end(i));
      if (!share_out(polytope, vertex, all).helpers.empty()) ++count;
    }
  return count;
}

}  // namespace contactvi

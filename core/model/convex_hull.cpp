#include "model/convex_hull.hpp"

#include <algorithm>
#include <array>
#include <cstdio>
#include <limits>
#include <memory>
#include <string>

extern "C" {
#include <libqhull_r/libqhull_r.h>
}

#include "base/error.hpp"
#include "base/numerics.hpp"

namespace contactvi {

namespace {

// Triangles, as coal asks for them. The second: where merging facets within rounding makes one of them wide, which is
// an error otherwise.
constexpr std::array<const char*, 2> kOptions = {"qhull Qt", "qhull Qt Q12"};

struct Close {
  void operator()(std::FILE* file) const { std::fclose(file); }
};

// The hull of points, which it copies. qhull's state is in qhull's own words (its macros name it qh).
class Qhull {
 public:
  Qhull(const double* points, std::size_t count, const char* options)
      : silent_(std::fopen("/dev/null", "w")), copy_(points, points + 3 * count) {
    // qhull explains its errors at length, and ends the process where it has no file for that.
    if (!silent_) throw Error("/dev/null cannot be opened");
    if (count > static_cast<std::size_t>(std::numeric_limits<int>::max() / 3)) throw Error("too many points");
    std::string words = options;
    qh_zero(&state, nullptr);
    found_ = qh_new_qhull(&state, 3, static_cast<int>(count), copy_.data(), False, words.data(), nullptr,
                          silent_.get()) == 0;
  }
  ~Qhull() {
    int long_blocks, long_bytes;
    qh_freeqhull(&state, !qh_ALL);
    qh_memfreeshort(&state, &long_blocks, &long_bytes);
  }
  Qhull(const Qhull&) = delete;
  Qhull& operator=(const Qhull&) = delete;

  bool found() const { return found_; }
  qhT state;

 private:
  std::unique_ptr<std::FILE, Close> silent_;
  std::vector<double> copy_;
  bool found_;
};

// The hull by the first of the options with which there is one.
std::unique_ptr<Qhull> find_hull(const double* points, std::size_t count) {
  std::unique_ptr<Qhull> hull;
  for (const char* options : kOptions) {
    hull = std::make_unique<Qhull>(points, count, options);
    if (hull->found()) break;
  }
  return hull;
}

}  // namespace

std::vector<int> hull_vertices(const double* points, std::size_t count) {
  const std::unique_ptr<Qhull> hull = find_hull(points, count);
  std::vector<int> found;
  if (!hull->found()) return found;
  qhT* const qh = &hull->state;
  facetT* facet;
  vertexT *vertex, **vertexp;
  FORALLfacets { FOREACHvertex_(facet->vertices) found.push_back(qh_pointid(qh, vertex->point)); }
  std::sort(found.begin(), found.end());
  found.erase(std::unique(found.begin(), found.end()), found.end());
  return found;
}

Polytope hull_of(const double* points, std::size_t count) {
  Planes planes;
  return hull_of(points, count, planes);
}

Polytope hull_of(const double* points, std::size_t count, Planes& planes) {
  const std::unique_ptr<Qhull> hull = find_hull(points, count);
  Polytope result;
  if (!hull->found()) return result;
  qhT* const qh = &hull->state;
  result.vertices.resize(qh->num_vertices, 3);
  result.faces.resize(qh->num_facets, 3);
  planes.resize(qh->num_facets, 4);
  std::vector<int> number(count, -1);  // of each point among the vertices
  Eigen::Index n = 0, m = 0;
  vertexT *vertex, **vertexp;
  FORALLvertices {
    number[qh_pointid(qh, vertex->point)] = static_cast<int>(n);
    result.vertices.row(n++) = Eigen::Map<const Eigen::RowVector3d>(vertex->point);
  }
  Vec3 center = Vec3::Zero();
  for (Eigen::Index i = 0; i < n; ++i) center += result.vertices.row(i);
  center /= static_cast<double>(n);
  facetT* facet;
  FORALLfacets {
    int k = 0, corners[3] = {-1, -1, -1};
    FOREACHvertex_(facet->vertices) if (k < 3) corners[k++] = number[qh_pointid(qh, vertex->point)];
    if (k < 3 || corners[0] < 0 || corners[1] < 0 || corners[2] < 0) continue;
    const Vec3 a = result.vertices.row(corners[0]), b = result.vertices.row(corners[1]),
               c = result.vertices.row(corners[2]);
    if (((a + b + c) / 3.0 - center).dot((b - a).cross(c - b)) < 0.0) std::swap(corners[0], corners[1]);
    planes.row(m) << facet->normal[0], facet->normal[1], facet->normal[2], -facet->offset;
    result.faces.row(m++) << corners[0], corners[1], corners[2];
  }
  result.faces.conservativeResize(m, 3);
  planes.conservativeResize(m, 4);
  return result;
}

}  // namespace contactvi

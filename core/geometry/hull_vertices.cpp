#include "geometry/hull_vertices.hpp"

#include <algorithm>
#include <cstdio>
#include <memory>

extern "C" {
#include <libqhull_r/libqhull_r.h>
}

#include "base/error.hpp"

namespace contactvi {

namespace {

// qhull's state, in qhull's own words (its macros name it qh); released where the scope ends.
struct Qhull {
  Qhull() { qh_zero(&state, nullptr); }
  ~Qhull() {
    int long_blocks, long_bytes;
    qh_freeqhull(&state, !qh_ALL);
    qh_memfreeshort(&state, &long_blocks, &long_bytes);
  }
  Qhull(const Qhull&) = delete;
  Qhull& operator=(const Qhull&) = delete;
  qhT state;
};

struct Close {
  void operator()(std::FILE* file) const { std::fclose(file); }
};

}  // namespace

std::vector<int> hull_vertices(const double* points, int count) {
  // qhull explains its errors at length, and ends the process where it has no file for that.
  const std::unique_ptr<std::FILE, Close> silent(std::fopen("/dev/null", "w"));
  if (!silent) throw Error("/dev/null cannot be opened");
  std::vector<double> copy(points, points + 3 * static_cast<std::size_t>(count));
  Qhull hull;
  qhT* const qh = &hull.state;
  char options[] = "qhull Qt";  // triangles, as the hulls that coal makes
  std::vector<int> found;
  if (qh_new_qhull(qh, 3, count, copy.data(), False, options, nullptr, silent.get()) != 0) return found;
  facetT* facet;
  vertexT *vertex, **vertexp;
  FORALLfacets { FOREACHvertex_(facet->vertices) found.push_back(qh_pointid(qh, vertex->point)); }
  std::sort(found.begin(), found.end());
  found.erase(std::unique(found.begin(), found.end()), found.end());
  return found;
}

}  // namespace contactvi

#include "geometry/hull_walk.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {

constexpr std::size_t kFew = 96;         // vertices up to which a look at all is quicker
constexpr double kHullRounding = 1e-13;  // of the size of a hull
constexpr double kRoughnesses = 2.0;     // a rough hull is off by its roughness up and down

// The direction through the middle of a cell of the cube.
Vec3 middle_of(int cell, int cells) {
  const int side = cell / (cells * cells), u = cell / cells % cells, v = cell % cells;
  Vec3 m;
  m[side / 2] = side % 2 == 0 ? 1.0 : -1.0;
  m[(side / 2 + 1) % 3] = (2.0 * u + 1.0) / cells - 1.0;
  m[(side / 2 + 2) % 3] = (2.0 * v + 1.0) / cells - 1.0;
  return m;
}

int cell_of(const Vec3& m, int cells) {
  int axis = 0;
  const double largest = m.cwiseAbs().maxCoeff(&axis);
  const auto place = [&](double x) {
    return std::clamp(static_cast<int>(0.5 * (x / largest + 1.0) * cells), 0, cells - 1);
  };
  const int side = 2 * axis + (m[axis] < 0.0 ? 1 : 0);
  return (side * cells + place(m[(axis + 1) % 3])) * cells + place(m[(axis + 2) % 3]);
}

}  // namespace

bool HullWalk::List::holds(int v) const {
  return std::find(vertices.begin(), vertices.begin() + count, v) != vertices.begin() + count;
}

HullWalk::HullWalk(const std::vector<Vec3>& vertices, const std::vector<std::array<int, 2>>& ends, double roughness) {
  const std::size_t n = vertices.size();
  if (n < kFew) return;
  double size = 0.0;
  for (const Vec3& x : vertices) size = std::max(size, x.cwiseAbs().maxCoeff());
  slack_ = kRoughnesses * roughness + kHullRounding * size;
  first_.assign(n + 1, 0);
  for (const auto& [i, j] : ends) {
    ++first_[i + 1];
    ++first_[j + 1];
  }
  for (std::size_t i = 0; i < n; ++i) first_[i + 1] += first_[i];
  neighbors_.resize(2 * ends.size());
  std::vector<int> at(first_.begin(), first_.end() - 1);
  for (const auto& [i, j] : ends) {
    neighbors_[at[i]++] = j;
    neighbors_[at[j]++] = i;
  }
  for (int cell = 0; cell < 6 * kCells * kCells; ++cell)
    starts_.push_back(climb(vertices, middle_of(cell, kCells), cell > 0 ? starts_.back() : 0));
}

int HullWalk::climb(const std::vector<Vec3>& vertices, const Vec3& m, int from) const {
  double most = m.dot(vertices[from]);
  for (;;) {
    const int here = from;
    for (int k = first_[here]; k < first_[here + 1]; ++k) {
      const int next = neighbors_[k];
      const double along = m.dot(vertices[next]);
      if (along <= most) continue;
      most = along;
      from = next;
    }
    if (from == here) return here;
  }
}

// Adds to the list, which holds a start, what hangs together with it beyond `least`.
bool HullWalk::spread(const std::vector<Vec3>& vertices, const Vec3& m, double least, List& found) const {
  for (int done = 0; done < found.count; ++done) {
    const int here = found.vertices[done];
    for (int k = first_[here]; k < first_[here + 1]; ++k) {
      const int next = neighbors_[k];
      if (m.dot(vertices[next]) < least || found.holds(next)) continue;
      if (found.count == kMost) return false;
      found.vertices[found.count++] = next;
    }
  }
  return true;
}

int HullWalk::farthest(const std::vector<Vec3>& vertices, const Vec3& m) const {
  List found;
  found.vertices[0] = climb(vertices, m, starts_[cell_of(m, kCells)]);
  found.count = 1;
  if (!spread(vertices, m, m.dot(vertices[found.vertices[0]]) - slack_, found)) return -1;
  int best = found.vertices[0];
  double most = m.dot(vertices[best]);
  for (int k = 1; k < found.count; ++k) {
    const int v = found.vertices[k];
    const double along = m.dot(vertices[v]);
    if (along < most || (along == most && v > best)) continue;
    most = along;
    best = v;
  }
  return best;
}

bool HullWalk::list(const std::vector<Vec3>& vertices, const Vec3& m, int farthest, double least, List& found) const {
  found.vertices[0] = farthest;
  found.count = 1;
  if (!spread(vertices, m, least - slack_, found)) return false;
  std::sort(found.vertices.begin(), found.vertices.begin() + found.count);
  return true;
}

}  // namespace contactvi

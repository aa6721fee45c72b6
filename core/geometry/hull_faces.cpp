#include "geometry/hull_faces.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "geometry/planar_hull.hpp"

namespace contactvi {

namespace {

// Points closer to a plane than this part of the hull's size lie on it: meshes come in single precision, and the
// vertices of rounded hulls are intersections of such planes.
constexpr double kFlatFace = 4e-7;
// Points closer to each other than this part of the hull's size are one.
constexpr double kSame = 1e-9;
// [rad] Faces and sides at a larger angle are not one, however small they are: a vertex where more than three faces
// meet becomes several in a rounded hull, at most 1e-6 m apart.
constexpr double kStraight = 1e-3;
// Writes the corners in order of the convex hull of points that lie in one plane, without those on its sides. `all` is
// reordered.
void order_corners(const Points& points, std::vector<int>& all, const Vec3& normal, double flat,
                   std::vector<int>& hull) {
  Eigen::Index smallest;
  normal.cwiseAbs().minCoeff(&smallest);
  const Vec3 u = normal.cross(Vec3::Unit(smallest)).normalized(), v = normal.cross(u);
  auto at = [&](int i) { return Eigen::Vector2d(points[i].dot(u), points[i].dot(v)); };
  // A corner lies farther than `flat`, or of a short side than a part of it, to the right of the line between its
  // neighbours.
  auto turns = [&](int i, int j, int k) {
    const Eigen::Vector2d a = at(i), b = at(j), c = at(k);
    const double ex = c[0] - a[0], ey = c[1] - a[1], length = std::hypot(ex, ey);
    const double left = length == 0.0 ? 0.0 : (ex * (b[1] - a[1]) - ey * (b[0] - a[0])) / length;
    return left < -std::min(flat, kStraight * std::min((b - a).norm(), (c - b).norm()));
  };
  planar_hull(all, at, turns, hull);
}

// Per point the faces that have it: short lists in one array.
class FacesOfPoints {
 public:
  explicit FacesOfPoints(std::size_t points) : last_(points, -1) {}

  void add(int point, int face) {
    entries_.push_back({face, last_[point]});
    last_[point] = static_cast<int>(entries_.size()) - 1;
  }
  // Whether one face has all three points.
  bool share(int a, int b, int c) const {
    for (int k = last_[a]; k >= 0; k = entries_[k].before)
      if (has(b, entries_[k].face) && has(c, entries_[k].face)) return true;
    return false;
  }

 private:
  struct Entry {
    int face, before;  // before: the entry of the same point that was added before, -1 for none
  };
  bool has(int point, int face) const {
    int k = last_[point];
    while (k >= 0 && entries_[k].face > face) k = entries_[k].before;  // Faces are added in ascending order.
    return k >= 0 && entries_[k].face == face;
  }

  std::vector<int> last_;
  std::vector<Entry> entries_;
};

// Which points of a hull its triangles join, points at the same place being one. Finds the points in a plane that
// touches the hull by walking from one to the next: those above any plane are joined with each other.
class FaceWalk {
 public:
  FaceWalk(const Points& points, const std::vector<coal::Triangle>& triangles, const std::vector<int>& same)
      : points_(points), start_(points.size() + 1, 0), count_(points.size(), 0), walk_of_(points.size(), 0) {
    for (const coal::Triangle& t : triangles)
      for (int k = 0; k < 3; ++k) start_[same[t[k]] + 1] += 2;  // No point has more neighbours.
    std::partial_sum(start_.begin(), start_.end(), start_.begin());
    neighbors_.resize(start_.back());
    for (const coal::Triangle& t : triangles)
      for (int k = 0; k < 3; ++k) {
        const int i = same[t[k]], j = same[t[(k + 1) % 3]];
        if (i == j) continue;
        join(i, j);
        join(j, i);
      }
  }

  // The points within `flat` of the plane, ascending; the three numbers are some of them.
  void find(const Vec3& normal, double offset, double flat, std::initializer_list<int> start, std::vector<int>& found) {
    found.clear();
    ++walk_;
    open_.clear();
    for (int i : start) enter(i);
    while (!open_.empty()) {
      const int i = open_.back();
      open_.pop_back();
      const double above = normal.dot(points_[i]) - offset;
      if (above < -flat) continue;
      if (!(above > flat)) found.push_back(i);
      for (int k = start_[i]; k < start_[i] + count_[i]; ++k) enter(neighbors_[k]);
    }
    std::sort(found.begin(), found.end());
  }

 private:
  void join(int i, int j) {
    const auto first = neighbors_.begin() + start_[i], last = first + count_[i];
    if (std::find(first, last, j) != last) return;
    *last = j;
    ++count_[i];
  }
  void enter(int i) {
    if (walk_of_[i] == walk_) return;
    walk_of_[i] = walk_;
    open_.push_back(i);
  }

  const Points& points_;
  // The neighbours of point i: count_[i] numbers from neighbors_[start_[i]] on.
  std::vector<int> start_, count_, neighbors_;
  std::vector<int> walk_of_;  // the last walk that came to the point
  std::vector<int> open_;
  int walk_ = 0;
};

// Twice the area of a triangle, times its normal.
Vec3 area_of(const Points& points, const coal::Triangle& t) {
  return (points[t[1]] - points[t[0]]).cross(points[t[2]] - points[t[0]]);
}

// Normals of the triangles at each point.
class Normals {
 public:
  Normals(const Points& points, const std::vector<coal::Triangle>& triangles, const std::vector<int>& same)
      : first_(points.size() + 1, 0) {
    for (const coal::Triangle& t : triangles)
      for (int k = 0; k < 3; ++k) ++first_[same[t[k]] + 1];
    std::partial_sum(first_.begin(), first_.end(), first_.begin());
    list_.resize(first_.back());
    std::vector<int> at(first_.begin(), first_.end() - 1);
    for (const coal::Triangle& t : triangles) {
      const Vec3 area = area_of(points, t);
      for (int k = 0; k < 3; ++k) list_[at[same[t[k]]]++] = area;
    }
  }
  // Whether a triangle at the point has nearly this normal, or the opposite one.
  bool is_near(int point, const Vec3& normal) const {
    for (int k = first_[point]; k < first_[point + 1]; ++k)
      if (normal.cross(list_[k]).squaredNorm() <= kStraight * kStraight * list_[k].squaredNorm()) return true;
    return false;
  }

 private:
  std::vector<int> first_;
  std::vector<Vec3> list_;  // of point i: from first_[i] on
};

// The triangles that have a normal, largest first, equal ones in their order.
std::vector<int> by_size(const Points& points, const std::vector<coal::Triangle>& triangles, double size) {
  std::vector<std::pair<double, int>> sizes;
  sizes.reserve(triangles.size());
  for (std::size_t i = 0; i < triangles.size(); ++i) {
    const double area = area_of(points, triangles[i]).norm();
    if (area > kSame * kSame * size * size) sizes.emplace_back(-area, static_cast<int>(i));
  }
  std::sort(sizes.begin(), sizes.end());
  std::vector<int> order;
  order.reserve(sizes.size());
  for (const auto& [area, i] : sizes) order.push_back(i);
  return order;
}

// Per point the first one that is within `near` of it; the first of that one if it has one.
std::vector<int> first_at_same_place(const Points& points, double near) {
  const int n = static_cast<int>(points.size());
  std::vector<int> same(n), place(n);
  std::vector<std::pair<double, int>> order(n);  // by x
  for (int i = 0; i < n; ++i) order[i] = {points[i][0], i};
  std::sort(order.begin(), order.end());
  for (int k = 0; k < n; ++k) place[order[k].second] = k;
  for (int i = 0; i < n; ++i) {
    int first = i;
    auto compare = [&](int k) {  // false: this point and those beyond it are too far along x
      const auto [x, j] = order[k];
      if (std::abs(x - points[i][0]) > near) return false;
      if (j < first && (points[i] - points[j]).squaredNorm() <= near * near) first = j;
      return true;
    };
    for (int k = place[i] - 1; k >= 0 && compare(k);) --k;
    for (int k = place[i] + 1; k < n && compare(k);) ++k;
    same[i] = first == i ? i : same[first];
  }
  return same;
}

}  // namespace

HullFaces::HullFaces(const Points& points, const std::vector<coal::Triangle>& triangles)
    : points_(points), triangles_(triangles), center_(Vec3::Zero()) {
  Vec3 low = points[0], high = points[0];
  for (const Vec3& p : points) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
    center_ += p / static_cast<double>(points.size());
  }
  size_ = (high - low).norm();
  same_ = first_at_same_place(points, kSame * size_);
}

Polygons HullFaces::merged(double& roughness) const {
  FaceWalk walk(points_, triangles_, same_);
  const Normals normals(points_, triangles_, same_);
  Polygons polygons;
  FacesOfPoints known(points_.size());
  std::vector<int> all, corners;
  const double flat = kFlatFace * size_;
  for (const int seed : by_size(points_, triangles_, size_)) {
    const coal::Triangle& t = triangles_[seed];
    const int a = same_[t[0]], b = same_[t[1]], c = same_[t[2]];
    if (known.share(a, b, c)) continue;
    Vec3 normal = area_of(points_, t).normalized();
    if (normal.dot(points_[a] - center_) < 0.0) normal = -normal;
    walk.find(normal, normal.dot(points_[a]), flat, {a, b, c}, all);
    all.erase(std::remove_if(all.begin(), all.end(), [&](int i) { return !normals.is_near(i, normal); }), all.end());
    order_corners(points_, all, normal, flat, corners);
    if (corners.size() < 3) continue;
    // The plane of the whole polygon (Newell) has less rounding than that of one triangle.
    Vec3 n = Vec3::Zero();
    for (std::size_t k = 0; k < corners.size(); ++k)
      n += (points_[corners[k]] - points_[corners[0]])
               .cross(points_[corners[(k + 1) % corners.size()]] - points_[corners[0]]);
    normal = n.normalized();
    double offset = -std::numeric_limits<double>::infinity();
    for (int i : corners) offset = std::max(offset, normal.dot(points_[i]));
    for (int i : corners) roughness = std::max(roughness, offset - normal.dot(points_[i]));
    for (int i : all) known.add(i, static_cast<int>(polygons.faces().size()));
    polygons.push(normal, offset);
    for (int i : corners) polygons.push_corner(i);
  }
  return polygons;
}

Polygons HullFaces::single() const {
  Polygons faces;
  for (const coal::Triangle& t : triangles_) {
    const int a = same_[t[0]], b = same_[t[1]], c = same_[t[2]];
    const Vec3 normal = (points_[b] - points_[a]).cross(points_[c] - points_[a]);
    if (!(normal.norm() > kSame * kSame * size_ * size_)) continue;
    if (normal.dot(points_[a] - center_) >= 0.0) {
      faces.push(normal.normalized(), normal.normalized().dot(points_[a]), {a, b, c});
    } else {
      faces.push(-normal.normalized(), -normal.normalized().dot(points_[a]), {a, c, b});
    }
  }
  return faces;
}

}  // namespace contactvi

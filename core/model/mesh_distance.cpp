#include "model/mesh_distance.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

namespace contactvi {

namespace {

// The point of a triangle that is nearest to x, and the number of the feature on which it lies: corners 0 to 2, edges
// 3 to 5 from the corner before, the face 6 (Ericson, "Real-time collision detection", 2005, section 5.1.5).
struct Nearest {
  Vec3 point;
  int feature;
};

Nearest nearest_on(const Vec3 (&c)[3], const Vec3& x) {
  const Vec3 ab = c[1] - c[0], ac = c[2] - c[0], ax = x - c[0], bx = x - c[1], cx = x - c[2];
  const double d1 = ab.dot(ax), d2 = ac.dot(ax), d3 = ab.dot(bx), d4 = ac.dot(bx), d5 = ab.dot(cx), d6 = ac.dot(cx);
  if (d1 <= 0.0 && d2 <= 0.0) return {c[0], 0};
  if (d3 >= 0.0 && d4 <= d3) return {c[1], 1};
  if (d6 >= 0.0 && d5 <= d6) return {c[2], 2};
  const double vc = d1 * d4 - d3 * d2, vb = d5 * d2 - d1 * d6, va = d3 * d6 - d5 * d4;
  if (vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0) return {c[0] + d1 / (d1 - d3) * ab, 3};
  if (va <= 0.0 && d4 >= d3 && d5 >= d6) return {c[1] + (d4 - d3) / (d4 - d3 + d5 - d6) * (c[2] - c[1]), 4};
  if (vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0) return {c[0] + d2 / (d2 - d6) * ac, 5};
  const double sum = va + vb + vc;
  return {c[0] + vb / sum * ab + vc / sum * ac, 6};
}

}  // namespace

MeshDistance::MeshDistance(const Points& vertices, const Faces& faces) : tree_(boxes(vertices, faces)) {
  std::vector<Vec3> at_vertex(static_cast<std::size_t>(vertices.rows()), Vec3::Zero());
  std::map<std::pair<int, int>, Vec3> at_edge;
  const auto edge = [](int a, int b) { return std::pair<int, int>(std::min(a, b), std::max(a, b)); };
  for (Eigen::Index i = 0; i < faces.rows(); ++i) {
    Triangle t;
    for (int k = 0; k < 3; ++k) t.corner[k] = vertices.row(faces(i, k)).transpose();
    t.normals[6] = (t.corner[1] - t.corner[0]).cross(t.corner[2] - t.corner[0]).normalized();
    for (int k = 0; k < 3; ++k) {
      const Vec3 next = t.corner[(k + 1) % 3] - t.corner[k], last = t.corner[(k + 2) % 3] - t.corner[k];
      const double angle = std::atan2(next.cross(last).norm(), next.dot(last));
      at_vertex[static_cast<std::size_t>(faces(i, k))] += angle * t.normals[6];
      at_edge.try_emplace(edge(faces(i, k), faces(i, (k + 1) % 3)), Vec3::Zero()).first->second += t.normals[6];
    }
    triangles_.push_back(t);
  }
  for (Eigen::Index i = 0; i < faces.rows(); ++i)
    for (int k = 0; k < 3; ++k) {
      Triangle& t = triangles_[static_cast<std::size_t>(i)];
      t.normals[k] = at_vertex[static_cast<std::size_t>(faces(i, k))];
      t.normals[3 + k] = at_edge.at(edge(faces(i, k), faces(i, (k + 1) % 3)));
    }
}

std::vector<BoxTree::Box> MeshDistance::boxes(const Points& vertices, const Faces& faces) {
  std::vector<BoxTree::Box> boxes(static_cast<std::size_t>(faces.rows()));
  for (Eigen::Index i = 0; i < faces.rows(); ++i)
    for (int k = 0; k < 3; ++k) boxes[static_cast<std::size_t>(i)].extend(vertices.row(faces(i, k)).transpose());
  return boxes;
}

double MeshDistance::of(const Vec3& x, double limit) const {
  double least = std::numeric_limits<double>::infinity();
  Vec3 from = Vec3::Zero(), normal = Vec3::UnitZ();
  tree_.near(x, limit, [&](int i) {
    const Triangle& t = triangles_[static_cast<std::size_t>(i)];
    const Nearest nearest = nearest_on(t.corner, x);
    const double distance = (x - nearest.point).norm();
    if (distance < least) {
      least = distance;
      from = x - nearest.point;
      normal = t.normals[nearest.feature];
    }
    return std::min(limit, least);
  });
  return from.dot(normal) < 0.0 ? -least : least;
}

}  // namespace contactvi

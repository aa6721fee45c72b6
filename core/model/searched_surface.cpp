#include "model/searched_surface.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

void SearchedSurface::set_parts(const std::vector<BoxTree::Box>& boxes, std::vector<Part> parts) {
  parts_ = std::move(parts);
  tree_ = BoxTree(boxes);
  cones_.resize(tree_.nodes().size());
  tree_.each_node([this](std::size_t node, const int* first, const int* last) {
    Vec3 sum = Vec3::Zero();
    for (const int* k = first; k != last; ++k) sum += parts_[static_cast<std::size_t>(*k)].normal;
    Cone cone{sum.normalized(), sum.norm() > 0.0 ? 0.0 : M_PI, 0.0, 0.0};
    for (const int* k = first; k != last && cone.angle < M_PI; ++k) {
      const Part& part = parts_[static_cast<std::size_t>(*k)];
      const double apart = std::acos(std::clamp(cone.axis.dot(part.normal), -1.0, 1.0));
      cone.angle = std::max(cone.angle, part.spread < 1.0 ? apart + std::asin(part.spread) : M_PI);
    }
    cone.cosine = std::cos(cone.angle);
    cone.sine = std::sin(cone.angle);
    cones_[node] = cone;
  });
}

}  // namespace contactvi

#include "run/geometry_paths.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace contactvi {

GeometryPaths::GeometryPaths(std::size_t geometries) : bends_(geometries), foretold_(geometries) {
  straight_.setConstant(4, static_cast<Eigen::Index>(geometries), kNaN);
}

void GeometryPaths::restart(const MatX& straight) {
  straight_.setConstant(kNaN);
  if (straight.size() > 0) straight_ = straight;
  for (std::vector<Bend>& bends : bends_) bends.clear();
  std::fill(foretold_.begin(), foretold_.end(), char{0});
}

void GeometryPaths::forget(int geometry) {
  straight_(0, geometry) = kNaN;
  bends_[geometry].clear();
  foretold_[geometry] = 0;
}

void GeometryPaths::set(int geometry, const std::vector<Bend>& bends, const Vec3& along, double besides) {
  straight_.col(geometry) << along, besides;
  bends_[geometry] = bends;
}

void GeometryPaths::foretell(int geometry, const Vec3& along, double besides) {
  set(geometry, {}, along, besides);
  foretold_[geometry] = 1;
}

// Where a geometry is in a part of the interval, from where it is at its start.
Vec3 GeometryPaths::place(int geometry, double part) const {
  Bend from{0.0, Vec3::Zero()}, to{1.0, straight_.col(geometry).head<3>()};
  for (const Bend& bend : bends_[geometry]) {
    if (bend.part >= part) {
      to = bend;
      break;
    }
    from = bend;
  }
  return to.part > from.part ? Vec3(from.at + (part - from.part) / (to.part - from.part) * (to.at - from.at)) : to.at;
}

// Between the bends of both they move against each other along a straight line, at the ends of which they are nearest.
double GeometryPaths::approach(int a, int b, const Vec3& direction) const {
  if (std::isnan(straight_(0, a)) || std::isnan(straight_(0, b))) return std::numeric_limits<double>::infinity();
  double nearer = 0.0;
  const auto look = [&](const Vec3& relative) {
    nearer = std::max(nearer, direction.isZero(0.0) ? relative.norm() : -direction.dot(relative));
  };
  look((straight_.col(b) - straight_.col(a)).head<3>());
  for (int end : {a, b})
    for (const Bend& bend : bends_[end]) look(place(b, bend.part) - place(a, bend.part));
  return nearer + straight_(3, a) + straight_(3, b);
}

}  // namespace contactvi

#include "model/height_field.hpp"

#include <algorithm>
#include <cmath>

#include "model/cubic_splines.hpp"
#include "model/foot_search.hpp"

namespace contactvi {

namespace {

constexpr int kRounds = 100;
// [m] Of a point that is nearer to the border of the top than this the normal is that of the top.
constexpr double kOnEdge = 1e-9;
// [cells] Rounding of the border of a cell.
constexpr double kAtBorder = 1e-9;
// In units of 1 + |slope|^2: with a lower curvature of the squared distance a place is a saddle and no foot.
constexpr double kSaddle = -1e-6;
// [cells] From a saddle the search goes on beside it.
constexpr double kBeside = 0.2;
// Places on the border of a cell.
constexpr int kOnBorder = 8;

SearchedSurface::Place place_on_top(const HeightField::Vec2& u, const HeightField::Height& h) {
  const Vec3 normal = Vec3(-h.slope[0], -h.slope[1], 1.0).normalized();
  const Mat3 across = Mat3::Identity() - normal * normal.transpose();
  Mat3 second = Mat3::Zero();
  second.topLeftCorner<2, 2>() = h.bend;
  // The normal (-slope, 1) / length changes along the surface by -P (H dx, 0) / length, P across it.
  return {Vec3(u[0], u[1], h.f), normal, -normal[2] * across * second * across};
}

}  // namespace

// The search for a foot on the top of the block from one place.
class HeightField::Search {
 public:
  Search(const HeightField& field, const Vec3& x, const Vec2& start) : field_(&field), x_(x) {
    Vec2 next = field.held(start);
    for (int round = 0; round < kRounds && !ends_; ++round) next = take(next);
  }

  bool found() const { return ends_ && !is_saddle_; }
  bool at_saddle() const { return ends_ && is_saddle_; }
  double square() const { return square_; }
  const Vec2& at() const { return at_; }
  // Whether the place is no higher than the point. From beside the block the solid under a higher one is nearer.
  bool is_below() const { return height_.f <= x_[2]; }

  SurfaceFoot foot() const {
    const Vec3 normal = Vec3(-height_.slope[0], -height_.slope[1], 1.0).normalized();
    const Vec3 from(x_[0] - at_[0], x_[1] - at_[1], x_[2] - height_.f);
    if (!on_border() || square_ <= kOnEdge * kOnEdge) return {normal.dot(from), normal};
    const double distance = field_->is_outside(x_) ? std::sqrt(square_) : -std::sqrt(square_);
    return {distance, from / distance};
  }

  Mat3 bend() const { return on_border() ? Mat3(Mat3::Constant(kNaN)) : place().bend; }
  Place place() const { return place_on_top(at_, height_); }
  bool is_on_top() const { return !on_border(); }

 private:
  // The gradient of the squared distance.
  Vec2 skew() const { return at_ - x_.head<2>() + (height_.f - x_[2]) * height_.slope; }
  // Whether the distance falls along the axis across the border.
  bool is_held(int axis, const Vec2& skew) const {
    return (at_[axis] <= field_->low_[axis] && skew[axis] > 0.0) ||
           (at_[axis] >= field_->high_[axis] && skew[axis] < 0.0);
  }
  bool on_border() const {
    const Vec2 skew = this->skew();
    return is_held(0, skew) || is_held(1, skew);
  }

  Vec2 take(const Vec2& next) {
    const Height height = field_->at(next);
    const Vec3 from(next[0] - x_[0], next[1] - x_[1], height.f - x_[2]);
    const double square = from.squaredNorm();
    if (last_ || square <= square_ * (1.0 + kSquareRounding)) {
      square_ = square;
      at_ = next;
      height_ = height;
      damping_ = damping_ * kLess < kNoDamping ? 0.0 : damping_ * kLess;
    } else {
      damping_ = std::max(kFirstDamping, kMore * damping_);
    }
    ends_ = last_;
    return ends_ ? next : step();
  }

  // Damping in units of 1 + |slope|^2, about what the Hessian of the squared distance is on an inclined plane.
  Vec2 step() {
    const Vec2 skew = this->skew();
    Mat2 hessian = Mat2::Identity() + height_.slope * height_.slope.transpose() + (height_.f - x_[2]) * height_.bend;
    Vec2 rest = skew;
    for (int axis = 0; axis < 2; ++axis) {
      if (!is_held(axis, skew)) continue;
      rest[axis] = 0.0;
      hessian(0, 1) = hessian(1, 0) = 0.0;
      hessian(axis, axis) = 1.0;
    }
    const double size = 1.0 + height_.slope.squaredNorm();
    const double middle = 0.5 * hessian.trace(),
                 least = middle - std::sqrt(std::max(0.0, middle * middle - hessian.determinant()));
    is_saddle_ = least < kSaddle * size;
    if (damping_ > 0.0 || !(least > 0.0))
      hessian.diagonal().array() += std::max(damping_ * size, kFirstDamping * size - least);
    const Vec2 next = field_->held(at_ - hessian.inverse() * rest);
    last_ = (next - at_).norm() <= kLast * std::sqrt(square_) + kLastLength;
    return next;
  }

  const HeightField* field_;
  Vec3 x_;
  Vec2 at_ = Vec2::Zero();
  Height height_{};
  double square_ = kInfinity, damping_ = 0.0;
  bool last_ = false, ends_ = false, is_saddle_ = false;
};

HeightField::HeightField(MatX coefficients, const Vec2& corner, const Vec2& spacing, Lost lost)
    : SearchedSurface(spacing.norm(), std::move(lost)),
      coefficients_(std::move(coefficients)),
      low_(corner),
      high_(corner),
      spacing_(spacing),
      cells_x_(static_cast<int>(coefficients_.rows()) - 3),
      cells_y_(static_cast<int>(coefficients_.cols()) - 3),
      slopes_(slopes()),
      boxes_(boxes()) {
  high_ += spacing.cwiseProduct(Vec2(cells_x_, cells_y_));
  std::vector<Part> parts;
  for (int cell = 0; cell < static_cast<int>(boxes_.size()); ++cell) parts.push_back(part_in(cell));
  set_parts(boxes_, std::move(parts));
  border_ = places_on_border();
}

// Directions of normals by the slopes are a central projection, in which a cone of normals is convex: in a rectangle of
// slopes they differ most at a corner.
HeightField::Part HeightField::part_in(int cell) const {
  const Vec2 u = middle_of(cell);
  const Height h = at(u);
  const Place middle = place_on_top(u, h);
  const BoxTree::Box& box = boxes_[static_cast<std::size_t>(cell)];
  const Slopes& slopes = slopes_[static_cast<std::size_t>(cell)];
  double reach = 0.0, spread = 0.0;
  for (int c = 0; c < 8; ++c) {
    reach = std::max(reach, (box.corner(static_cast<BoxTree::Box::CornerType>(c)) - middle.at).norm());
    const Vec3 normal(c % 2 == 0 ? -slopes.least[0] : -slopes.most[0],
                      c / 2 % 2 == 0 ? -slopes.least[1] : -slopes.most[1], 1.0);
    spread = std::max(spread, middle.normal.cross(normal.normalized()).norm());
    if (!(middle.normal.dot(normal) > 0.0)) spread = kInfinity;
  }
  return {middle.at, middle.normal, middle.bend, reach, spread < kMostSpread ? spread : kInfinity};
}

std::vector<Vec3> HeightField::places_on_border() const {
  std::vector<Vec3> places;
  const int count[2] = {kOnBorder * cells_x_, kOnBorder * cells_y_};
  for (int axis = 0; axis < 2; ++axis)
    for (int k = 0; k <= count[axis]; ++k)
      for (const Vec2& end : {low_, high_}) {
        Vec2 u = end;
        u[axis] = low_[axis] + (high_[axis] - low_[axis]) * k / count[axis];
        places.emplace_back(u[0], u[1], at(held(u)).f);
      }
  return places;
}

// Cell i, j is number i cells_y + j; within it the height is between the least and the largest of its coefficients.
std::vector<BoxTree::Box> HeightField::boxes() const {
  std::vector<BoxTree::Box> boxes;
  boxes.reserve(static_cast<std::size_t>(cells_x_) * static_cast<std::size_t>(cells_y_));
  for (int i = 0; i < cells_x_; ++i)
    for (int j = 0; j < cells_y_; ++j) {
      const auto own = coefficients_.block<4, 4>(i, j);
      const Vec2 corner = low_ + spacing_.cwiseProduct(Vec2(i, j)), far = corner + spacing_;
      boxes.emplace_back(Vec3(corner[0], corner[1], own.minCoeff()), Vec3(far[0], far[1], own.maxCoeff()));
    }
  return boxes;
}

// Slopes are sums of products of quadratic and cubic B-splines, within the range of the differences of coefficients.
std::vector<HeightField::Slopes> HeightField::slopes() const {
  std::vector<Slopes> slopes;
  slopes.reserve(static_cast<std::size_t>(cells_x_) * static_cast<std::size_t>(cells_y_));
  for (int i = 0; i < cells_x_; ++i)
    for (int j = 0; j < cells_y_; ++j) {
      const Eigen::Matrix4d own = coefficients_.block<4, 4>(i, j);
      const Eigen::Matrix<double, 3, 4> x = (own.bottomRows<3>() - own.topRows<3>()) / spacing_[0];
      const Eigen::Matrix<double, 4, 3> y = (own.rightCols<3>() - own.leftCols<3>()) / spacing_[1];
      slopes.push_back({{x.minCoeff(), y.minCoeff()}, {x.maxCoeff(), y.maxCoeff()}});
    }
  return slopes;
}

// At a foot within the rectangle u = x + (z - f) grad f; at one on its border that lies beyond it.
bool HeightField::may_hold(int cell, const Vec3& point) const {
  const BoxTree::Box& box = boxes_[static_cast<std::size_t>(cell)];
  const Slopes& slopes = slopes_[static_cast<std::size_t>(cell)];
  const double above[2] = {point[2] - box.max()[2], point[2] - box.min()[2]};
  const int place[2] = {cell / cells_y_, cell % cells_y_}, last[2] = {cells_x_ - 1, cells_y_ - 1};
  for (int axis = 0; axis < 2; ++axis) {
    const double ends[4] = {above[0] * slopes.least[axis], above[0] * slopes.most[axis], above[1] * slopes.least[axis],
                            above[1] * slopes.most[axis]};
    const double least = point[axis] + *std::min_element(ends, ends + 4),
                 most = point[axis] + *std::max_element(ends, ends + 4), rounding = kAtBorder * spacing_[axis];
    if (place[axis] > 0 && most < box.min()[axis] - rounding) return false;
    if (place[axis] < last[axis] && least > box.max()[axis] + rounding) return false;
  }
  return true;
}

HeightField::Height HeightField::at(const Vec2& u) const {
  const Vec2 place = (u - low_).cwiseQuotient(spacing_);
  const int i = std::clamp(static_cast<int>(place[0]), 0, cells_x_ - 1),
            j = std::clamp(static_cast<int>(place[1]), 0, cells_y_ - 1);
  const CubicSplines x(place[0] - i), y(place[1] - j);
  const auto own = coefficients_.block<4, 4>(i, j);
  const Eigen::Vector4d along = own * y.value, change = own * y.first;
  Height h;
  h.f = x.value.dot(along);
  h.slope << x.first.dot(along) / spacing_[0], x.value.dot(change) / spacing_[1];
  const double mixed = x.first.dot(change) / (spacing_[0] * spacing_[1]);
  h.bend << x.second.dot(along) / (spacing_[0] * spacing_[0]), mixed, mixed,
      x.value.dot(own * y.second) / (spacing_[1] * spacing_[1]);
  return h;
}

HeightField::Vec2 HeightField::middle_of(int cell) const {
  return low_ + spacing_.cwiseProduct(Vec2(cell / cells_y_ + 0.5, cell % cells_y_ + 0.5));
}

// A cell on the border may hold feet on its sides there and in its corner, beside one within.
std::vector<HeightField::Vec2> HeightField::border_starts(int cell, const Vec2& u) const {
  const BoxTree::Box& box = boxes_[static_cast<std::size_t>(cell)];
  const int place[2] = {cell / cells_y_, cell % cells_y_}, last[2] = {cells_x_ - 1, cells_y_ - 1};
  const Vec2 nearest = u.cwiseMax(box.min().head<2>()).cwiseMin(box.max().head<2>());
  std::vector<Vec2> starts{nearest};
  for (int axis = 0; axis < 2; ++axis) {
    const std::size_t before = starts.size();
    for (std::size_t k = 0; k < before; ++k) {
      Vec2 start = starts[k];
      if (place[axis] == 0) starts.push_back((start[axis] = low_[axis], start));
      if (place[axis] == last[axis]) starts.push_back((start[axis] = high_[axis], start));
    }
  }
  starts.erase(starts.begin());
  return starts;
}

bool HeightField::is_outside(const Vec3& point) const {
  const Vec2 u = point.head<2>();
  return held(u) != u || point[2] > at(u).f;
}

bool HeightField::holds(int cell, const Vec2& u) const {
  return ((u - middle_of(cell)).cwiseAbs().array() <= 0.5 * spacing_.array()).all();
}

bool HeightField::beside(const Vec3& point, SurfaceFoot& foot) const {
  const Vec2 border = held(point.head<2>()), out = point.head<2>() - border;
  const double distance = out.norm();
  if (!(distance > 0.0) || point[2] > at(border).f) return false;
  foot = {distance, Vec3(out[0] / distance, out[1] / distance, 0.0)};
  return true;
}

// Of a point in the block.
SurfaceFoot HeightField::nearest_side(const Vec3& point) const {
  const Vec2 u = point.head<2>(), from_low = u - low_, to_high = high_ - u;
  SurfaceFoot foot{-kInfinity, Vec3::UnitZ()};
  for (int axis = 0; axis < 2; ++axis) {
    if (-from_low[axis] > foot.distance) foot = {-from_low[axis], -Vec3::Unit(axis)};
    if (-to_high[axis] > foot.distance) foot = {-to_high[axis], Vec3::Unit(axis)};
  }
  return foot;
}

void HeightField::all_feet(const Vec3& point, double reach, std::vector<SurfaceFoot>& feet) const {
  feet.resize(1);
  if (beside(point, feet[0])) return;
  std::vector<Search> found;
  double nearest = kInfinity;
  const bool beyond = held(point.head<2>()) != point.head<2>();
  const auto limit = [&] { return std::max(nearest, reach); };
  const auto search = [&](const Vec2& start) {
    Search s(*this, point, start);
    if (s.at_saddle()) s = Search(*this, point, s.at() + kBeside * Vec2(spacing_[0], 0.5 * spacing_[1]));
    if (!s.found() || (beyond && !s.is_below())) return;
    const double distance = std::sqrt(s.square()), same = kOneFoot * distance + kOneFootLength;
    nearest = std::min(nearest, distance);
    for (const Search& other : found)
      if ((other.at() - s.at()).norm() <= same) return;
    found.push_back(s);
  };
  search(point.head<2>());
  tree().near(point, limit(), [&](int cell) {
    const bool known = std::any_of(found.begin(), found.end(), [&](const Search& s) { return holds(cell, s.at()); });
    if (!may_hold(cell, point)) return limit();
    if (!known) search(middle_of(cell));
    for (const Vec2& start : border_starts(cell, point.head<2>())) search(start);
    return limit();
  });
  std::sort(found.begin(), found.end(), [](const Search& a, const Search& b) { return a.square() < b.square(); });
  feet.clear();
  for (const Search& s : found)
    if (feet.empty() || (s.square() < reach * reach && feet[0].distance > 0.0 && s.foot().distance > 0.0))
      feet.push_back(s.foot());
  if (feet.empty()) feet.push_back({kNaN, Vec3::UnitZ()});
  if (!(feet[0].distance < 0.0)) return;
  const SurfaceFoot side = nearest_side(point);
  if (side.distance > feet[0].distance) feet.assign(1, side);
}

SurfaceFoot HeightField::foot_near(const Vec3& point, const Vec3& place) const {
  SurfaceFoot foot{kNaN, Vec3::UnitZ()};
  if (!point.allFinite() || beside(point, foot)) return foot;
  const Search s(*this, point, place.head<2>());
  return s.found() ? s.foot() : foot;
}

bool HeightField::foot_place(const Vec3& point, const Vec3& start, Place& foot) const {
  if (!point.allFinite() || !start.allFinite()) return false;
  const Search s(*this, point, start.head<2>());
  if (!s.found() || !s.is_on_top()) return false;
  foot = s.place();
  return true;
}

Mat3 HeightField::bend(const Vec3& point, const Vec3& place) const {
  SurfaceFoot foot{};
  if (beside(point, foot)) return Mat3::Zero();
  const Search s(*this, point, place.head<2>());
  return s.found() ? s.bend() : Mat3(Mat3::Constant(kNaN));
}

void HeightField::find(const Vec3* points, int count, double /*ball*/, SurfaceFoot* feet) const {
  std::vector<SurfaceFoot> found;
  for (int i = 0; i < count; ++i) {
    all_feet(points[i], 0.0, found);
    feet[i] = found[0];
  }
}

}  // namespace contactvi

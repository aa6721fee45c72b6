#include "model/function_surface.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "model/foot_search.hpp"

namespace contactvi {

namespace {

using Vec2 = Eigen::Vector2d;
using Mat2 = Eigen::Matrix2d;

// A step of this length, of the distance and in metres, is the last one: Newton's method doubles the digits, and with a
// Hessian by differences a step leaves 1e-6 of its length.
constexpr double kLastStep = 1e-9, kLastStepLength = 1e-10;
constexpr int kFunctionRounds = 100;
// Of the distance, and [m]: what may be left along the surface of the way from the foot to the point. More is left in a
// kink, where steps become short because none descends.
constexpr double kSkew = 1e-6, kSkewLength = 1e-9;
// Searches begin at the place below and, of points higher than this [m], around it.
constexpr double kAround = 1e-6;
constexpr int kDirections = 8;
// Of a ball: feet that are no farther from each other are one.
constexpr double kApart = 0.05;
// [m] Iterations that diverge ask for points farther away than this: that they have no foot says nothing.
constexpr double kFarthest = 1e6;
// [m] Step of differences of gradients.
constexpr double kSide = 1e-5;

// The search for the foot of one point from one place. Where the function is asked next is next().
class FootSearch {
 public:
  FootSearch(const Vec3& x, const Vec2& start) : x_(x), next_(start) {}

  const Vec2& next() const { return next_; }
  bool ends() const { return state_ != State::kSearches; }
  bool found() const { return state_ == State::kFound; }
  double square() const { return square_; }
  const Vec2& at() const { return at_; }
  void fail() { state_ = State::kFailed; }

  void take(const double* values) {
    if (!std::all_of(values, values + HeightSurface::kValues, [](double v) { return std::isfinite(v); })) return fail();
    const Vec2 across = next_ - x_.head<2>();
    const double up = values[0] - x_[2], square = across.squaredNorm() + up * up;
    if (last_ || square <= square_ * (1.0 + kSquareRounding)) {
      square_ = square;
      at_ = next_;
      up_ = up;
      slope_ = {values[1], values[2]};
      bend_ << values[3], values[4], values[4], values[5];
      damping_ = damping_ * kLess < kNoDamping ? 0.0 : damping_ * kLess;
    } else {
      damping_ = std::max(kFirstDamping, kMore * damping_);
    }
    if (last_)
      state_ = skew().norm() <= kSkew * std::sqrt(square_) + kSkewLength ? State::kFound : State::kFailed;
    else
      choose_next();
  }

  SurfaceFoot foot() const {
    const Vec3 normal = Vec3(-slope_[0], -slope_[1], 1.0).normalized();
    return {normal.dot(Vec3(x_[0] - at_[0], x_[1] - at_[1], -up_)), normal};
  }

  // Of the normal (-slope, 1) / length: along the surface it changes by -P (H dx, 0) / length, P across the normal.
  Mat3 bend() const {
    const Vec3 normal = foot().normal;
    const Mat3 across = Mat3::Identity() - normal * normal.transpose();
    Mat3 second = Mat3::Zero();
    second.topLeftCorner<2, 2>() = bend_;
    return -normal[2] * across * second * across;
  }

 private:
  enum class State : std::uint8_t { kSearches, kFound, kFailed };

  // The gradient of the squared distance.
  Vec2 skew() const { return at_ - x_.head<2>() + up_ * slope_; }

  // Damping in units of 1 + |slope|^2, about what the Hessian of the squared distance is on an inclined plane.
  void choose_next() {
    Mat2 hessian = Mat2::Identity() + slope_ * slope_.transpose() + up_ * bend_;
    const double size = 1.0 + slope_.squaredNorm();
    const double middle = 0.5 * hessian.trace(),
                 least = middle - std::sqrt(std::max(0.0, middle * middle - hessian.determinant()));
    const double needed = std::max(damping_ * size, kFirstDamping * size - least);
    if (damping_ > 0.0 || !(least > 0.0)) hessian.diagonal().array() += needed;
    const Vec2 step = -hessian.inverse() * skew();
    next_ = at_ + step;
    last_ = step.norm() <= kLastStep * std::sqrt(square_) + kLastStepLength;
  }

  Vec3 x_;
  Vec2 next_, at_ = Vec2::Zero(), slope_ = Vec2::Zero();
  Mat2 bend_ = Mat2::Zero();
  double square_ = std::numeric_limits<double>::infinity(), up_ = 0.0, damping_ = 0.0;
  bool last_ = false;
  State state_ = State::kSearches;
};

// Several searches side by side: the function is asked once in each round for all that go on.
void follow(std::vector<FootSearch>& searches, const HeightSurface::Function& function) {
  std::vector<double> places, values;
  for (int round = 0; round < kFunctionRounds; ++round) {
    places.clear();
    for (const FootSearch& s : searches)
      if (!s.ends()) places.insert(places.end(), {s.next()[0], s.next()[1]});
    if (places.empty()) return;
    const std::size_t count = places.size() / 2;
    values.assign(HeightSurface::kValues * count, kNaN);
    function(places.data(), static_cast<int>(count), values.data());
    const double* row = values.data();
    for (FootSearch& s : searches) {
      if (s.ends()) continue;
      s.take(row);
      row += HeightSurface::kValues;
    }
  }
  for (FootSearch& s : searches)
    if (!s.ends()) s.fail();
}

// The searches of points, those of point i from first[i] to before first[i + 1].
void search(const Vec3* points, int count, const HeightSurface::Function& function, std::vector<FootSearch>& searches,
            std::vector<std::size_t>& first) {
  constexpr int kValues = HeightSurface::kValues;
  std::vector<double> below(2 * static_cast<std::size_t>(count)),
      values(kValues * static_cast<std::size_t>(count), kNaN);
  for (int i = 0; i < count; ++i) {
    below[2 * i] = points[i][0];
    below[2 * i + 1] = points[i][1];
  }
  function(below.data(), count, values.data());
  for (int i = 0; i < count; ++i) {
    first.push_back(searches.size());
    const Vec2 start = points[i].head<2>();
    searches.emplace_back(points[i], start);
    searches.back().take(values.data() + kValues * i);
    const double height = points[i][2] - values[kValues * i];
    if (!(height > kAround)) continue;
    for (int k = 0; k < kDirections; ++k) {
      const double angle = 2.0 * M_PI * k / kDirections;
      searches.emplace_back(points[i], start + 0.5 * height * Vec2(std::cos(angle), std::sin(angle)));
    }
  }
  first.push_back(searches.size());
  follow(searches, function);
}

// The nearest one of the feet that were found; null: a search has failed. A function that fails at one place fails:
// that is no reason to take another foot.
const FootSearch* best_of(const std::vector<FootSearch>& searches, std::size_t from, std::size_t to) {
  const FootSearch* best = nullptr;
  for (std::size_t k = from; k < to; ++k) {
    if (!searches[k].found()) return nullptr;
    if (best == nullptr || searches[k].square() < best->square()) best = &searches[k];
  }
  return best;
}

// Whether a ball about the point reaches another foot beside the best one.
bool touches_twice(const std::vector<FootSearch>& searches, std::size_t from, std::size_t to, const FootSearch& best,
                   double ball) {
  for (std::size_t k = from; k < to; ++k)
    if (searches[k].square() < ball * ball && (searches[k].at() - best.at()).norm() > kApart * ball) return true;
  return false;
}

}  // namespace

void FunctionSurface::nearest(const Vec3* points, int count, double ball, SurfaceFoot* feet) const {
  bool finite = true;
  for (int i = 0; i < count; ++i) finite &= points[i].allFinite();
  if (!finite) {
    std::fill_n(feet, count, SurfaceFoot{kNaN, Vec3::UnitZ()});
    return;
  }
  find(points, count, ball, feet);
  for (int i = 0; i < count; ++i)
    if (!std::isfinite(feet[i].distance) && points[i].norm() < kFarthest) lost_(points[i]);
}

void FunctionSurface::all_feet(const Vec3& point, double reach, std::vector<SurfaceFoot>& feet) const {
  feet.resize(1);
  nearest(&point, 1, reach, feet.data());
}

SurfaceFoot FunctionSurface::foot_near(const Vec3& point, const Vec3& /*place*/) const {
  SurfaceFoot foot{};
  nearest(&point, 1, 0.0, &foot);
  return foot;
}

void HeightSurface::find(const Vec3* points, int count, double ball, SurfaceFoot* feet) const {
  std::vector<FootSearch> searches;
  std::vector<std::size_t> first;
  search(points, count, function_, searches, first);
  for (int i = 0; i < count; ++i) {
    const FootSearch* best = best_of(searches, first[i], first[i + 1]);
    const bool known = best != nullptr && !touches_twice(searches, first[i], first[i + 1], *best, ball);
    feet[i] = known ? best->foot() : SurfaceFoot{kNaN, Vec3::UnitZ()};
  }
}

Mat3 HeightSurface::bend(const Vec3& point, const Vec3& /*place*/) const {
  std::vector<FootSearch> searches;
  std::vector<std::size_t> first;
  search(&point, 1, function_, searches, first);
  const FootSearch* best = best_of(searches, first[0], first[1]);
  return best == nullptr ? Mat3(Mat3::Constant(kNaN)) : best->bend();
}

Mat3 DistanceSurface::bend(const Vec3& point, const Vec3& /*place*/) const {
  SurfaceFoot foot{};
  nearest(&point, 1, 0.0, &foot);
  const Vec3 at = point - foot.distance * foot.normal;
  Vec3 places[6];
  for (int k = 0; k < 3; ++k) {
    places[2 * k] = at + kSide * Vec3::Unit(k);
    places[2 * k + 1] = at - kSide * Vec3::Unit(k);
  }
  SurfaceFoot feet[6];
  nearest(places, 6, 0.0, feet);
  Mat3 second;
  for (int k = 0; k < 3; ++k) second.col(k) = (feet[2 * k].normal - feet[2 * k + 1].normal) / (2.0 * kSide);
  const Mat3 across = Mat3::Identity() - foot.normal * foot.normal.transpose();
  const bool known = std::isfinite(foot.distance) &&
                     std::all_of(feet, feet + 6, [](const SurfaceFoot& f) { return std::isfinite(f.distance); });
  return known ? Mat3(0.5 * across * (second + second.transpose()) * across) : Mat3(Mat3::Constant(kNaN));
}

void DistanceSurface::find(const Vec3* points, int count, double /*ball*/, SurfaceFoot* feet) const {
  std::vector<double> values(kValues * static_cast<std::size_t>(count), kNaN);
  function_(points[0].data(), count, values.data());
  for (int i = 0; i < count; ++i) {
    const double* row = values.data() + kValues * i;
    const Vec3 gradient(row[1], row[2], row[3]);
    const double length = gradient.norm();
    const bool is_distance = std::abs(length - 1.0) <= kUnit;
    feet[i] = {is_distance && std::isfinite(row[0]) ? row[0] : kNaN,
               is_distance ? Vec3(gradient / length) : Vec3::UnitZ()};
  }
}

}  // namespace contactvi

#include "model/implicit_surface.hpp"

#include <algorithm>
#include <cmath>

#include "base/numerics.hpp"
#include "model/foot_search.hpp"

namespace contactvi {

namespace {

using Vec2 = Eigen::Vector2d;
using Mat2 = Eigen::Matrix2d;

constexpr int kSolidRounds = 60, kReturns = 30;
// Of the size of a cell: a way back onto the surface that is no longer is the last one. What it leaves is its square,
// by the curvature of the level set, which is no more than a few in a cell: of no more than 1e-14, and rounding.
constexpr double kBack = 1e-7;
// Of the size of a cell: no longer step; and beyond this way another cell has searches of its own.
constexpr double kLongest = 1.0, kFarthestCells = 4.0;
// With a lower curvature of the squared distance a place is a saddle and no foot.
constexpr double kSolidSaddle = -1e-6;
// Normals in a cell differ from that in its middle by no more than this times the largest difference at its corners.
constexpr double kMoreSpread = 1.5;

SearchedSurface::Place place_of(const Vec3& at, const LevelSet::Value& v) {
  const double length = v.gradient.norm();
  const Vec3 normal = v.gradient / length;
  const Mat3 across = Mat3::Identity() - normal * normal.transpose();
  return {at, normal, across * v.hessian * across / length};
}

}  // namespace

class ImplicitSurface::Search {
 public:
  Search(const ImplicitSurface& surface, const Vec3& x, const Vec3& start, double farthest)
      : surface_(&surface), x_(x), start_(start), farthest_(farthest) {
    Vec3 next = start;
    for (int round = 0; round < kSolidRounds && state_ == State::kSearches; ++round) next = take(next);
  }

  bool found() const { return state_ == State::kFound && !is_saddle_; }
  bool at_saddle() const { return state_ == State::kFound && is_saddle_; }
  double square() const { return square_; }
  const Vec3& at() const { return at_; }
  SurfaceFoot foot() const { return {normal_.dot(x_ - at_), normal_}; }
  Place place() const { return place_of(at_, surface_->value(at_)); }
  // A place beside a saddle.
  Vec3 beside() const { return at_ + 0.3 * surface_->size() * any_tangent(normal_); }

 private:
  enum class State : std::uint8_t { kSearches, kFound, kFailed };

  Vec3 take(Vec3 p) {
    LevelSet::Value v;
    if (!surface_->back(p, v)) {
      if (square_ == kInfinity || damping_ > 1e6) state_ = State::kFailed;
      damping_ = std::max(kFirstDamping, kMore * damping_);
      return square_ == kInfinity ? p : step();
    }
    const double square = (p - x_).squaredNorm();
    if (last_ || square <= square_ * (1.0 + kSquareRounding)) {
      square_ = square;
      at_ = p;
      value_ = v;
      normal_ = v.gradient.normalized();
      damping_ = damping_ * kLess < kNoDamping ? 0.0 : damping_ * kLess;
    } else {
      damping_ = std::max(kFirstDamping, kMore * damping_);
    }
    if (last_) state_ = State::kFound;
    if ((at_ - start_).norm() > farthest_) state_ = State::kFailed;
    return state_ == State::kSearches ? step() : at_;
  }

  // In the tangent plane: with the multiplier of the surface the Hessian is that of the Lagrangian.
  Vec3 step() {
    const Vec3 from = at_ - x_, t1 = any_tangent(normal_), t2 = normal_.cross(t1);
    const Mat3 lagrangian = Mat3::Identity() - from.dot(normal_) / value_.gradient.norm() * value_.hessian;
    Eigen::Matrix<double, 3, 2> T;
    T << t1, t2;
    Mat2 hessian = T.transpose() * lagrangian * T;
    const double middle = 0.5 * hessian.trace(),
                 least = middle - std::sqrt(std::max(0.0, middle * middle - hessian.determinant()));
    is_saddle_ = least < kSolidSaddle;
    if (damping_ > 0.0 || !(least > 0.0)) hessian.diagonal().array() += std::max(damping_, kFirstDamping - least);
    Vec2 s = -hessian.inverse() * (T.transpose() * from);
    const double length = s.norm(), longest = kLongest * surface_->size();
    if (length > longest) s *= longest / length;
    last_ = length <= kLast * std::sqrt(square_) + kLastLength;
    return at_ + T * s;
  }

  const ImplicitSurface* surface_;
  Vec3 x_, start_, at_ = Vec3::Zero(), normal_ = Vec3::UnitZ();
  LevelSet::Value value_{};
  double square_ = kInfinity, damping_ = 0.0, farthest_;
  bool last_ = false, is_saddle_ = false;
  State state_ = State::kSearches;
};

// The place on the surface next to p, and the level set there: the last way is so short that its second derivatives
// stay what they were, and the gradient follows by them.
bool ImplicitSurface::back(Vec3& p, LevelSet::Value& v) const {
  for (int k = 0; k < kReturns; ++k) {
    v = value(p);
    const double square = v.gradient.squaredNorm();
    if (!std::isfinite(v.f) || !(square > 0.0)) return false;
    const Vec3 step = v.f / square * v.gradient;
    const double longest = kLongest * size(), length = step.norm();
    p -= length > longest ? Vec3(longest / length * step) : step;
    if (length > kBack * size()) continue;
    v.f = 0.0;
    v.gradient -= v.hessian * step;
    return true;
  }
  return false;
}

ImplicitSurface::ImplicitSurface(std::unique_ptr<const LevelSet> level, bool inverse, const BoxTree::Box& box,
                                 const Eigen::Vector3i& cells, Lost lost)
    : SearchedSurface(box.sizes().cwiseQuotient(cells.cast<double>()).norm(), std::move(lost)),
      level_(std::move(level)),
      sign_(inverse ? -1.0 : 1.0),
      boxes_(passed(box, cells)) {
  std::vector<Part> parts;
  for (const BoxTree::Box& cell : boxes_) parts.push_back(part_in(cell));
  set_parts(boxes_, std::move(parts));
}

SearchedSurface::Part ImplicitSurface::part_in(const BoxTree::Box& cell) const {
  Place place;
  // Where the way to the surface is not found no range is known.
  if (!onto(cell.center(), place)) place = place_of(cell.center(), value(cell.center()));
  Part part{place.at, place.normal, place.bend, 0.5 * size() + (place.at - cell.center()).norm(), 0.0};
  for (int c = 0; c < 8; ++c) {
    const Vec3 normal = value(cell.corner(static_cast<BoxTree::Box::CornerType>(c))).gradient.normalized();
    const double sine = kMoreSpread * part.normal.cross(normal).norm();
    part.spread = sine < kMostSpread && part.normal.dot(normal) > 0.0 ? std::max(part.spread, sine) : kInfinity;
    if (part.spread == kInfinity) break;
  }
  if (place.at == cell.center()) part.spread = kInfinity;
  return part;
}

// Of a foot q of x in the cell x - q is along its normal.
bool ImplicitSurface::may_hold(const Part& part, const Vec3& point, double limit) const {
  if (part.spread == kInfinity) return true;
  const Vec3 from = point - part.place;
  const double along = from.dot(part.normal), aside = (from - along * part.normal).norm();
  const double out = std::max(0.0, aside - part.reach),
               near = std::max(0.0, std::abs(along) - part.reach * part.spread);
  return out <= (std::abs(along) + part.reach) * part.spread && near * near + out * out <= limit * limit;
}

LevelSet::Value ImplicitSurface::value(const Vec3& x) const {
  LevelSet::Value v = level_->at(x);
  if (sign_ < 0.0) v = {-v.f, -v.gradient, -v.hessian};
  return v;
}

// The cells of a grid whose corners do not all lie on one side.
std::vector<BoxTree::Box> ImplicitSurface::passed(const BoxTree::Box& box, const Eigen::Vector3i& cells) const {
  const Vec3 spacing = box.sizes().cwiseQuotient(cells.cast<double>());
  const auto corner = [&](int i, int j, int k) -> Vec3 { return box.min() + spacing.cwiseProduct(Vec3(i, j, k)); };
  const int ny = cells[1] + 1, nz = cells[2] + 1;
  std::vector<char> inside;
  for (int i = 0; i <= cells[0]; ++i)
    for (int j = 0; j < ny; ++j)
      for (int k = 0; k < nz; ++k) {
        // The ends of the box, which rounding may have left.
        const Vec3 x = corner(i, j, k).cwiseMax(box.min()).cwiseMin(box.max());
        inside.push_back(level_->at(x).f < 0.0 ? 1 : 0);
      }
  std::vector<BoxTree::Box> found;
  for (int i = 0; i < cells[0]; ++i)
    for (int j = 0; j < cells[1]; ++j)
      for (int k = 0; k < cells[2]; ++k) {
        int count = 0;
        for (int c = 0; c < 8; ++c)
          count += inside[static_cast<std::size_t>(((i + c / 4) * ny + j + c / 2 % 2) * nz + k + c % 2)];
        if (count > 0 && count < 8) found.emplace_back(corner(i, j, k), corner(i + 1, j + 1, k + 1));
      }
  return found;
}

void ImplicitSurface::all_feet(const Vec3& point, double reach, std::vector<SurfaceFoot>& feet) const {
  std::vector<Search> found;
  double nearest = kInfinity;
  const auto limit = [&] { return std::max(nearest, reach); };
  tree().near(point, kInfinity, [&](int cell) {
    const BoxTree::Box& box = boxes_[static_cast<std::size_t>(cell)];
    if (!may_hold(parts()[static_cast<std::size_t>(cell)], point, limit())) return limit();
    if (std::any_of(found.begin(), found.end(), [&](const Search& s) { return box.contains(s.at()); })) return limit();
    Search s(*this, point, box.center(), kFarthestCells * size());
    if (s.at_saddle()) s = Search(*this, point, s.beside(), kFarthestCells * size());
    if (!s.found()) return limit();
    const double distance = std::sqrt(s.square()), same = kOneFoot * distance + kOneFootLength;
    nearest = std::min(nearest, distance);
    if (std::none_of(found.begin(), found.end(), [&](const Search& o) { return (o.at() - s.at()).norm() <= same; }))
      found.push_back(s);
    return limit();
  });
  std::sort(found.begin(), found.end(), [](const Search& a, const Search& b) { return a.square() < b.square(); });
  feet.clear();
  for (const Search& s : found)
    if (feet.empty() || (s.square() < reach * reach && feet[0].distance > 0.0 && s.foot().distance > 0.0))
      feet.push_back(s.foot());
  if (feet.empty()) feet.push_back({kNaN, Vec3::UnitZ()});
}

SurfaceFoot ImplicitSurface::foot_near(const Vec3& point, const Vec3& place) const {
  if (!point.allFinite()) return {kNaN, Vec3::UnitZ()};
  const Search s(*this, point, place, kInfinity);
  return s.found() ? s.foot() : SurfaceFoot{kNaN, Vec3::UnitZ()};
}

bool ImplicitSurface::foot_place(const Vec3& point, const Vec3& start, Place& foot) const {
  const Search s(*this, point, start, kInfinity);
  if (s.found()) foot = s.place();
  return s.found() && foot.normal.allFinite();
}

bool ImplicitSurface::onto(const Vec3& point, Place& place) const {
  Vec3 p = point;
  LevelSet::Value v;
  if (!back(p, v)) return false;
  place = place_of(p, value(p));
  return place.normal.allFinite();
}

Mat3 ImplicitSurface::bend(const Vec3& point, const Vec3& place) const {
  const Search s(*this, point, place, kInfinity);
  return s.found() ? s.place().bend : Mat3(Mat3::Constant(kNaN));
}

void ImplicitSurface::find(const Vec3* points, int count, double /*ball*/, SurfaceFoot* feet) const {
  std::vector<SurfaceFoot> found;
  for (int i = 0; i < count; ++i) {
    all_feet(points[i], 0.0, found);
    feet[i] = found[0];
  }
}

}  // namespace contactvi

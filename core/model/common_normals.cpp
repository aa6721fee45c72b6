#include "model/common_normals.hpp"

#include <algorithm>
#include <cmath>

#include "base/numerics.hpp"
#include "model/distance_search.hpp"

namespace contactvi {

namespace {

using Vec2 = Eigen::Vector2d;
using Mat2 = Eigen::Matrix2d;
using Mat32 = Eigen::Matrix<double, 3, 2>;

constexpr int kBoundRounds = 16;
// Of the size of a cell: beyond this way another pair of cells has searches of its own.
constexpr double kFarthestSlide = 4.0;
// Of the reach of the two cells: where the quadratic surfaces through them may be wrong about their common normal.
constexpr double kGuess = 2.0;
// Of the reach of a cell: where a guess is no search of its own.
constexpr double kOneGuess = 1.0;

Mat32 tangents(const Vec3& n) {
  Mat32 T;
  T.col(0) = any_tangent(n);
  T.col(1) = n.cross(T.col(0));
  return T;
}

}  // namespace

class CommonNormals::Search : public DistanceSearch {
 public:
  // From a place p near the first surface and x near the second one, each in its own frame.
  Search(const CommonNormals& of, const Vec3& p, const Vec3& x, double farthest) : DistanceSearch(of.size()), of_(of) {
    if (!set(p, x)) return;
    const Vec3 start = here_.x.at;
    choose();
    slide([&](const Vec2& step) { return set(here_.p.at, here_.x.at + turned(step)); }, [&] { choose(); },
          [&] { return (here_.x.at - start).norm() > farthest; });
  }

  bool found() const { return faces() && DistanceSearch::found(); }
  bool at_saddle() const { return faces() && DistanceSearch::at_saddle(); }
  // Places in the frame of the second surface on both sides of a saddle.
  Vec3 beside(double sign) const { return here_.x.at + turned(to_beside(sign)); }
  const Vec3& first_place() const { return here_.p.at; }
  CommonNormal result() const { return {f(), here_.p.normal, here_.p.at, here_.x.at, is_flat()}; }
  const Mat3& first_bend() const { return here_.p.bend; }
  const Mat3& second_bend() const { return here_.B; }

 private:
  struct State {
    Place p, x;
    Vec3 m;  // the normal of the second surface, and how it turns, in the frame of the first one
    Mat3 B;
  };

  bool faces() const { return here_.m.dot(here_.p.normal) < 0.0; }
  // Along the ways, in the frame of the second surface.
  Vec3 turned(const Vec2& step) const { return of_.R_.transpose() * (T_ * step); }

  // Goes to the place next to x, if the distance falls. False: it does not.
  bool set(const Vec3& p, const Vec3& x) {
    State next;
    if (!of_.second_->onto(x, next.x)) return false;
    const Vec3 y = of_.placed(next.x.at);
    if (!of_.foot(y, p, next.p) || !falls_to(next.p.normal.dot(y - next.p.at))) return false;
    next.m = of_.R_ * next.x.normal;
    next.B = of_.R_ * next.x.bend * of_.R_.transpose();
    here_ = next;
    return true;
  }

  void choose() {
    T_ = tangents(here_.m);
    const Mat3 curvature = curvature_at(here_.p.bend, f()) - here_.m.dot(here_.p.normal) * here_.B;
    choose_step(T_.transpose() * here_.p.normal, T_.transpose() * curvature * T_);
  }

  const CommonNormals& of_;
  State here_{};
  Ways T_ = Ways::Zero();
};

bool CommonNormals::foot(const Vec3& point, const Vec3& start, Place& place) const {
  if (first_.surface != nullptr) return first_.surface->foot_place(point, start, place);
  place = {point - (first_.normal.dot(point) - first_.offset) * first_.normal, first_.normal, Mat3::Zero()};
  return true;
}

// Whether both places lie in the other solid, where the gap is negative: a side of one that is seen through it has such
// a gap, too.
bool CommonNormals::is_overlap(const CommonNormal& c) const {
  if (c.gap > -kSideRounding) return true;
  const Vec3 x = placed(c.second);
  const bool inside = first_.surface != nullptr ? first_.surface->is_inside(x) : first_.normal.dot(x) < first_.offset;
  return inside && second_->is_inside(R_.transpose() * (c.first - t_));
}

bool CommonNormals::near(const CommonNormal& known, CommonNormal& found) const {
  if (!t_.allFinite() || !R_.allFinite()) return false;
  const Search s(*this, known.first, known.second, kInfinity);
  if (s.found()) found = s.result();
  return s.found();
}

bool CommonNormals::bends(const CommonNormal& at, Mat3& first, Mat3& second) const {
  const Search s(*this, at.first, at.second, kInfinity);
  if (!s.found()) return false;
  first = s.first_bend();
  second = s.second_bend();
  return true;
}

// Whether normals of two nodes of the trees may be opposite to each other, and along a line between their boxes.
bool CommonNormals::may_face(std::size_t node, std::size_t other) const {
  const SearchedSurface::Cone &a = first_.surface->cones()[node], &b = second_->cones()[other];
  const Vec3 its_axis = R_ * b.axis;
  if (a.angle + b.angle < M_PI && -a.axis.dot(its_axis) < a.cosine * b.cosine - a.sine * b.sine) return false;
  const BoxTree::Box &own = first_.surface->tree().nodes()[node], &its = second_->tree().nodes()[other];
  const Vec3 from = placed(its.center()) - own.center();
  const double distance = from.norm(), reach = 0.5 * (own.diagonal().norm() + its.diagonal().norm());
  if (distance <= reach) return true;
  const double sine = reach / distance, cosine = std::sqrt(1.0 - sine * sine);
  const auto points = [&](const SearchedSurface::Cone& cone, const Vec3& axis) {
    return cone.angle >= 0.5 * M_PI || std::abs(axis.dot(from)) >= (cone.cosine * cosine - cone.sine * sine) * distance;
  };
  return points(a, a.axis) && points(b, its_axis);
}

// By the ranges of the normals of both: where they are not opposite, or point past the other cell, there is none.
bool CommonNormals::may_hold(const SearchedSurface::Part& a, const SearchedSurface::Part& b, double limit) const {
  if (a.spread == kInfinity || b.spread == kInfinity) return true;
  // Spreads are sines of angles below a right one.
  const double between = std::sqrt((1.0 - a.spread * a.spread) * (1.0 - b.spread * b.spread)) - a.spread * b.spread;
  if (-a.normal.dot(R_ * b.normal) < between) return false;
  const Vec3 from = placed(b.place) - a.place;
  const double along = from.dot(a.normal), aside = (from - along * a.normal).norm(), reach = a.reach + b.reach;
  const double out = std::max(0.0, aside - reach), near = std::max(0.0, std::abs(along) - reach);
  return out <= (std::abs(along) + reach) * a.spread && near * near + out * out <= limit * limit;
}

// Where it is positive, a lower bound on the gaps of common normals between two cells, as that of CylinderNormals, by
// the normal of the one cell or of the other. A place in the other one is farther from the plane through the middle of
// that cell than its own middle is but for its sag and for the angle between the planes of the two.
double CommonNormals::least_gap(const SearchedSurface::Part& a, const SearchedSurface::Part& b) const {
  const Vec3 its = R_ * b.normal, from = placed(b.place) - a.place;
  const double sine = a.normal.cross(its).norm(), sags = a.sag() + b.sag();
  return std::max(from.dot(a.normal) - sine * b.reach, -from.dot(its) - sine * a.reach) - sags;
}

// By the quadratic surfaces through both cells.
CommonNormals::Guess CommonNormals::guess(const SearchedSurface::Part& a, const SearchedSurface::Part& b,
                                          const std::vector<CommonNormal>& found) const {
  if (a.spread == kInfinity || b.spread == kInfinity) return Guess::kPossible;
  const Mat32 T = tangents(a.normal), its = R_.transpose() * T;
  const Vec3 from = placed(b.place) - a.place;
  const Mat2 A = T.transpose() * a.bend * T, away = Mat2::Identity() + a.normal.dot(from) * A;
  const double singular = away.determinant();
  if (std::abs(singular) < kFlatOfSize) return Guess::kPossible;
  const Mat2 back = away.inverse(), turning = A * back, hessian = turning + its.transpose() * b.bend * its;
  const double middle = 0.5 * hessian.trace(), product = hessian.determinant(),
               half = std::sqrt(std::max(0.0, middle * middle - product)), least = middle - half;
  if (std::min(std::abs(least), std::abs(middle + half)) * size() < kFlatOfSize) return Guess::kPossible;
  const Vec2 aside = T.transpose() * from;
  const Vec2 second = -hessian.inverse() * (its.transpose() * b.normal + turning * aside),
             first = back * (second + aside);
  if (first.norm() > kGuess * a.reach || second.norm() > kGuess * b.reach) return Guess::kNone;
  if (least < 0.0) return Guess::kPossible;
  const Vec3 p = a.place + T * first, x = b.place + its * second;
  const bool known = std::any_of(found.begin(), found.end(), [&](const CommonNormal& c) {
    return (c.first - p).norm() <= kOneGuess * a.reach && (c.second - x).norm() <= kOneGuess * b.reach;
  });
  return known ? Guess::kKnown : Guess::kPossible;
}

double CommonNormals::height(const Vec3& x) const { return first_.normal.dot(placed(x)) - first_.offset; }

double CommonNormals::lowest(const BoxTree::Box& box) const {
  return height(box.center()) - 0.5 * (R_.transpose() * first_.normal).cwiseAbs().dot(box.sizes());
}

// An upper bound on the distance of the surfaces: that of two places in their cells, each the nearest one to the other;
// from a plane that of the lowest place.
double CommonNormals::distance_bound() const {
  if (first_.surface == nullptr) {
    double least = kInfinity;
    second_->tree().where(
        [&](const BoxTree::Box& box) { return lowest(box) < least; },
        [&](int k) { least = std::min(least, height(second_->parts()[static_cast<std::size_t>(k)].place)); });
    return std::max(0.0, least);
  }
  const auto nearest = [](const SearchedSurface& of, Vec3& x) {
    double least = kInfinity;
    int best = -1;
    of.tree().near(x, kInfinity, [&](int k) {
      const double distance = (of.parts()[static_cast<std::size_t>(k)].place - x).norm();
      if (distance < least) best = k;
      return least = std::min(least, distance);
    });
    if (best >= 0) x = of.parts()[static_cast<std::size_t>(best)].place;
    return least;
  };
  Vec3 x = placed(second_->tree().nodes()[0].center());
  double least = kInfinity;
  for (int round = 0; round < kBoundRounds; ++round) {
    nearest(*first_.surface, x);
    x = R_.transpose() * (x - t_);
    const double distance = nearest(*second_, x);
    x = placed(x);
    if (!(distance < least)) break;
    least = distance;
  }
  return least * (1.0 + kSquareRounding);
}

void CommonNormals::all(const std::vector<CommonNormal>& known, double reach, std::vector<CommonNormal>& found,
                        std::vector<int>& number) const {
  const double own = size();
  const bool finite = t_.allFinite() && R_.allFinite();
  FoundNormals list(found, number, own, finite ? distance_bound() : kInfinity);
  if (!finite) return;
  const auto limit = [&] { return std::max({list.nearest(), reach, kDeepest * own}); };
  const auto matters = [&](const SearchedSurface::Part& a, const SearchedSurface::Part& b) {
    return !(least_gap(a, b) > std::max({list.nearest(), reach, 0.0})) && guess(a, b, found) == Guess::kPossible;
  };
  const auto add = [&](const Search& s, int which) {
    if (s.found() && is_overlap(s.result())) list.add(s.result(), which);
  };
  for (std::size_t k = 0; k < known.size(); ++k)
    add(Search(*this, known[k].first, known[k].second, kInfinity), static_cast<int>(k));
  const auto search = [&](const Vec3& p, const Vec3& x) {
    const Search s(*this, p, x, kFarthestSlide * own);
    add(s, -1);
    if (!s.at_saddle()) return;
    for (const double sign : {1.0, -1.0}) add(Search(*this, s.first_place(), s.beside(sign), kFarthestSlide * own), -1);
  };
  const std::vector<SearchedSurface::Part>& parts = second_->parts();
  if (first_.surface == nullptr) {
    second_->tree().where([&](const BoxTree::Box& box) { return lowest(box) <= limit(); },
                          [&](int k) {
                            const SearchedSurface::Part& b = parts[static_cast<std::size_t>(k)];
                            const double f = height(b.place);
                            const SearchedSurface::Part a{placed(b.place) - f * first_.normal, first_.normal,
                                                          Mat3::Zero(), b.reach, 0.0};
                            if (may_hold(a, b, kInfinity) && matters(a, b)) search(a.place, b.place);
                          });
  } else {
    const auto may = [this](std::size_t k, std::size_t l) { return may_face(k, l); };
    first_.surface->tree().near_pairs(second_->tree(), R_, t_, kInfinity, may, [&](int i, int j) {
      const SearchedSurface::Part &a = first_.surface->parts()[static_cast<std::size_t>(i)],
                                  &b = parts[static_cast<std::size_t>(j)];
      if (may_hold(a, b, limit()) && matters(a, b)) search(a.place, b.place);
      return limit();
    });
  }
  list.keep_within(reach);
}

}  // namespace contactvi
